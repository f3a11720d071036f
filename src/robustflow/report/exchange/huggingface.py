"""Hugging Face evaluation results: `.eval_results/*.yaml` in a model's repository, which the Hub shows on its page."""

from __future__ import annotations

import json
from pathlib import PurePosixPath

from .facts import RunFacts, RunMean


def huggingface_files(facts: RunFacts, dataset: str) -> dict[PurePosixPath, bytes]:
    """Return `.eval_results/robustflow.yaml` with the clean and average means."""
    text = "".join(_entry(facts, mean, dataset) for mean in facts.means)
    return {PurePosixPath(".eval_results", "robustflow.yaml"): text.encode()}


def _entry(facts: RunFacts, mean: RunMean, dataset: str) -> str:
    interval = "" if mean.interval is None else f"95 % interval {mean.interval[0]:.4g} to {mean.interval[1]:.4g}. "
    lines = [
        "- dataset:",
        f"    id: {_quoted(dataset)}",
        f"    task_id: {mean.metric}{'_clean' if mean.condition == 'clean' else ''}",
        f"  value: {mean.value!r}",
        *([f"  date: {_quoted(facts.finished.date().isoformat())}"] if facts.finished else []),
        "  evaluation_framework: robustflow",
        f"  notes: {_quoted(f'{interval}Run {facts.digest} of {facts.name}. ' + ' '.join(facts.warnings))}",
    ]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """Quote text for YAML."""
    return json.dumps(text.strip())
