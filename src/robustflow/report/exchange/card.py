"""The robustness card: what a reader of a model's page wants to know, as Markdown and as JSON."""

from __future__ import annotations

from pathlib import PurePosixPath

from ...analysis.labels import inside, long_label, metric_label
from ...atomic import json_bytes
from ...text import counted, joined
from ..render.markdown import escape
from .facts import RunFacts, RunMean

CARD_VERSION = 1
"""Incremented when a field of card.json is added or changes its meaning."""

_CHECK = (
    "robustflow pack RUN -o mine.robustflow",
    "robustflow verify mine.robustflow --exported card.md --exported card.json",
)


def card_files(facts: RunFacts) -> dict[PurePosixPath, bytes]:
    """`card.md` and `card.json`."""
    return {
        PurePosixPath("card.md"): _markdown(facts).encode(),
        PurePosixPath("card.json"): json_bytes(_content(facts)),
    }


def _content(facts: RunFacts) -> dict[str, object]:
    training = facts.run.provenance
    return {
        "format": "robustflow-card",
        "version": CARD_VERSION,
        "run": facts.digest,
        "robustflow": facts.version,
        "model": {
            "name": facts.name,
            "settings": facts.settings,
            "setting": training.setting,
            "trained_on": None if training.trained_on is None else list(training.trained_on),
            "basis": training.basis,
            "note": training.note,
        },
        "data": facts.data,
        "means": [
            {"metric": mean.metric, "condition": mean.condition, "value": mean.value, "interval_95": mean.interval}
            for mean in facts.means
        ],
        "warnings": facts.warnings,
        "check": list(_CHECK),
    }


def _markdown(facts: RunFacts) -> str:
    data, training = facts.data, facts.run.provenance
    unknown = "nothing" if training.setting == "knowledge" else "not stated"
    sets = unknown if training.trained_on is None else joined(list(training.trained_on) or ["nothing"])
    lines = [
        f"# Robustness of {escape(facts.name)} on {escape(facts.title)}",
        "",
        f"Trained on: {escape(sets)}; setting {escape(training.setting)} ({escape(training.basis)}).  ",
        f"Measured on {counted(data['pairs'], 'pair')} under {counted(len(data['corruptions']), 'corruption')} at "
        f"{counted(len(data['severities']), 'severity', 'severities')}, seed {data['seed']}, "
        f"RobustFlow {escape(facts.version)}, run `{facts.digest}`.",
        "",
        *(f"> **Warning.** {escape(warning)}\n" for warning in facts.warnings),
        "| Frames | Metric | Mean | 95 % interval |",
        "| :-- | :-- | --: | --: |",
        *(_row(mean) for mean in facts.means),
        "",
        "Check it: pack the run, or take its record, and compare this file with what follows from the rows.",
        "",
        "```bash",
        *_CHECK,
        "```",
    ]
    return "\n".join(lines) + "\n"


def _row(mean: RunMean) -> str:
    frames = {"clean": "clean", "average": "average"}.get(mean.condition) or inside(long_label(mean.condition))
    ends = "" if mean.interval is None else f"{mean.interval[0]:.3f} to {mean.interval[1]:.3f}"
    return f"| {escape(frames)} | {escape(metric_label(mean.metric))} | {mean.value:.3f} | {ends} |"
