"""How far a model's flow moves on RobustSpring, as results that a leaderboard shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import fsum
from typing import Any

import polars as pl

from ..benchmarks.setting import manifest_provenance
from ..corruptions.on_disk import ROBUSTSPRING
from ..runs.run import Run
from ..text import counted
from .results import AVERAGE, RESULT_SCHEMA
from .scores import OWN_SETTING


def robustspring_results(run: Run, moved: Mapping[str, Sequence[float]]) -> pl.DataFrame:
    """RCRE per corruption and their mean: columns of `results.RESULT_SCHEMA`.

    Args:
        run: whose model predicted.
        moved: its own name of a corruption -> of each pair the mean distance between corrupted and clean flow, pixels.
    """
    means = {ROBUSTSPRING.here(own): fsum(values) / len(values) for own, values in moved.items()}
    means[AVERAGE] = fsum(means.values()) / len(means)
    pairs = min(len(values) for values in moved.values())
    note = f"{counted(pairs, 'pair')}, all pixels; average over {counted(len(moved), 'corruption')}"
    head = (ROBUSTSPRING.dataset, _setting(run.manifest), run.name, "rcre")
    source, frames = str(run.manifest["identity_digest"]), f"{ROBUSTSPRING.title}, {note}"
    lines = [(*head, name, value, None, None, source, frames, note) for name, value in means.items()]
    return pl.DataFrame(lines, schema=RESULT_SCHEMA, orient="row")


def _setting(manifest: Mapping[str, Any]) -> str:
    """What the model's training means for RobustSpring's frames, whatever the run was on."""
    identity = {**manifest["identity"], "benchmark": ROBUSTSPRING.dataset}
    setting = str(manifest_provenance({**manifest, "identity": identity})["setting"])
    return OWN_SETTING if setting == "undeclared" else setting
