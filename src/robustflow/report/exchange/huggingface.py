"""Hugging Face: evaluation results for a model's page, `.eval_results/*.yaml` in its repository."""

from __future__ import annotations

import json
from pathlib import PurePosixPath

from .facts import RunFacts, RunMean


def huggingface_files(facts: RunFacts, dataset: str) -> dict[PurePosixPath, bytes]:
    """`.eval_results/robustflow.yaml` with the clean and average means.

    Args:
        facts: of the run.
        dataset: the data set's name on the Hub, ORGANISATION/NAME; its `eval.yaml` has to name the tasks `epe_clean`,
            `epe`, `cre`, `crer` and `rcre`.
    """
    text = "".join(_entry(facts, mean, dataset) for mean in facts.averages)
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
    """Quote a text so that nothing in it is special to YAML."""
    return json.dumps(text.strip())
