"""The robustness card of a model, as Markdown and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath

from ...analysis.labels import inside, long_label, metric_label
from ...atomic import json_bytes
from ...benchmarks.facts import sample_noun
from ...text import counted, joined
from ..render.markdown import escape
from ..table import interval_text
from .facts import RunFacts, RunMean

CARD_VERSION = 1
"""Schema version of card.json, incremented when a field is added or changes its meaning."""

_CHECK = (
    "robustflow record pack RUN -o mine.robustflow",
    "robustflow record verify mine.robustflow --exported card.md --exported card.json",
)


def card_files(facts: RunFacts) -> dict[PurePosixPath, bytes]:
    """Return `card.md` and `card.json`."""
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
            "backbone": training.backbone,
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
    count = counted(data["pairs"], sample_noun(facts.run.benchmark))
    lines = [
        f"# Robustness of {escape(facts.name)} on {escape(facts.title)}",
        "",
        f"Trained on: {escape(sets)}; backbone: {escape(training.backbone or 'none known')}; setting "
        f"{escape(training.setting)} ({escape(training.basis)}).  ",
        f"Measured on {count} under {counted(len(data['corruptions']), 'corruption')} at "
        f"{counted(len(data['severities']), 'severity', 'severities')}, seed {data['seed']}, "
        f"RobustFlow {escape(facts.version)}, run `{facts.digest}`.",
        "",
        *(f"> **Warning.** {escape(warning)}\n" for warning in facts.warnings),
        *_table(facts.means),
        "",
        "To verify this file, pack the run (or use an existing record) and compare the file with the record's export.",
        "",
        "```bash",
        *_CHECK,
        "```",
    ]
    return "\n".join(lines) + "\n"


def _table(means: Sequence[RunMean]) -> list[str]:
    """Return a Markdown table with one row per condition and one column per metric."""
    if not means:
        return ["Nothing could be measured."]
    cells = {(mean.condition, mean.metric): mean for mean in means}
    conditions, metrics = (list(dict.fromkeys(which)) for which in zip(*cells, strict=True))
    head = ["Frames", *(escape(metric_label(metric)) for metric in metrics)]
    lines = [f"| {' | '.join(head)} |", f"| :-- |{' --: |' * len(metrics)}"]
    for condition in conditions:
        frames = condition if condition in ("clean", "average") else inside(long_label(condition))
        values = (_cell(cells.get((condition, metric))) for metric in metrics)
        lines.append(f"| {escape(frames)} | {' | '.join(values)} |")
    brackets = any(mean.interval for mean in means)
    return [*lines, "", "Values in brackets are 95 % intervals."] if brackets else lines


def _cell(mean: RunMean | None) -> str:
    if mean is None:
        return ""
    return f"{mean.value:.3f} {interval_text(mean.interval, 3)}".rstrip()
