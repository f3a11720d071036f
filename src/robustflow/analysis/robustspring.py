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

ROBUSTNESS = ("epe", "fl", "px1")
"""RobustSpring's three numbers of a corrupted flow: the distance to the clean one in pixels, and the percentages of
pixels that it moves by more than Fl's bounds and by more than 1 px."""


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


def robustness_means(moved: Mapping[str, Sequence[Sequence[float]]]) -> dict[str, tuple[int, list[float]]]:
    """Corruption -> number of pairs and the means of `ROBUSTNESS` over them; "average" is the mean over corruptions.

    Args:
        moved: RobustSpring's own name of a corruption -> of each pair the numbers of `ROBUSTNESS`.
    """
    means = {ROBUSTSPRING.here(own): _columns(values) for own, values in moved.items()}
    pairs = {ROBUSTSPRING.here(own): len(values) for own, values in moved.items()}
    table = {name: (pairs[name], values) for name, values in means.items()}
    return table | {AVERAGE: (min(pairs.values()), _columns(list(means.values())))}


def robustness_csv(means: Mapping[str, tuple[int, Sequence[float]]]) -> str:
    """`robustness_means` as a file.

    >>> print(robustness_csv({"robustspring_fog": (4, [0.5, 2.0, 10.0])}), end="")
    corruption,pairs,epe,fl,px1
    robustspring_fog,4,0.5,2.0,10.0
    """
    lines = [",".join([name, str(pairs), *map(repr, values)]) for name, (pairs, values) in means.items()]
    return "\n".join([",".join(("corruption", "pairs", *ROBUSTNESS)), *lines]) + "\n"


def _columns(values: Sequence[Sequence[float]]) -> list[float]:
    return [fsum(column) / len(values) for column in zip(*values, strict=True)]


def _setting(manifest: Mapping[str, Any]) -> str:
    """What the model's training means for RobustSpring's frames, whatever the run was on."""
    identity = {**manifest["identity"], "benchmark": ROBUSTSPRING.dataset}
    setting = str(manifest_provenance({**manifest, "identity": identity})["setting"])
    return OWN_SETTING if setting == "undeclared" else setting
