"""Measure how a model's flow changes under corruption on RobustSpring, as results for a leaderboard."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import polars as pl

from ..core.text import counted, joined
from ..corruptions.registry import ON_DISK_PREFIX
from ..metrics.measures import exact_mean
from ..run.comparable import sample_set_of
from ..run.run import Run
from .frame import LINE, given_frame
from .results import AVERAGE, inside, long_label

if TYPE_CHECKING:
    from ..run.submission import Submitted

ROBUSTNESS = ("epe", "fl", "px1")
"""RobustSpring's three measures of a flow under corruption: its mean distance to the clean flow in pixels, and the
percentage of pixels whose flow changes by more than Fl's thresholds and by more than 1 px."""

_MOST_NAMED = 3


def robustspring_results(run: Run, flows: Iterable[Submitted]) -> pl.DataFrame:
    """Compute the RCRE per corruption and its mean, as a results frame. Results for the same corruptions of
    the same frames form one sample set.
    """
    flows = list(flows)
    moved: dict[str, list[float]] = {}
    for flow in flows:
        if flow.moved is not None:
            moved.setdefault(f"{ON_DISK_PREFIX}{flow.condition}", []).append(flow.moved[0])
    means = {name: exact_mean(values) for name, values in moved.items()}
    few = joined([inside(long_label(name)) for name in moved]) if len(moved) <= _MOST_NAMED else ""
    pairs = min(len(values) for values in moved.values())
    note = f"{counted(pairs, 'pair')}, all pixels; average over {few or counted(len(moved), 'corruption')}"
    means[AVERAGE] = exact_mean([*means.values()])
    cells = [(flow.key, flow.condition, int(flow.moved is not None), flow.frames, None) for flow in flows]
    frames = f"RobustSpring, {note}; frames {sample_set_of('', cells)}"
    head = dict(zip(LINE, ("robustspring", frames, _setting(run), run.name), strict=True))
    head |= {"note": note, "measure": "rcre", "origin": run.manifest.identity_digest}
    return given_frame(head | {"condition": name, "value": value} for name, value in means.items())


def robustness_means(moved: Mapping[str, Sequence[Sequence[float]]]) -> dict[str, tuple[int, list[float]]]:
    """Return, for each corruption, the number of pairs and the means of `ROBUSTNESS` over them; "average" is the mean
    over corruptions.
    """
    table = {f"{ON_DISK_PREFIX}{own}": (len(values), _columns(values)) for own, values in moved.items()}
    pairs, means = zip(*table.values(), strict=True)
    return table | {AVERAGE: (min(pairs), _columns(means))}


def robustness_csv(means: Mapping[str, tuple[int, Sequence[float]]]) -> str:
    """Format the result of `robustness_means` as CSV.

    >>> print(robustness_csv({"robustspring_fog": (4, [0.5, 2.0, 10.0])}), end="")
    corruption,pairs,epe,fl,px1
    robustspring_fog,4,0.5,2.0,10.0
    """
    lines = [",".join([name, str(pairs), *map(repr, values)]) for name, (pairs, values) in means.items()]
    return "\n".join([",".join(("corruption", "pairs", *ROBUSTNESS)), *lines]) + "\n"


def _columns(values: Sequence[Sequence[float]]) -> list[float]:
    return [exact_mean(column) for column in zip(*values, strict=True)]


def _setting(run: Run) -> str:
    """Return the model's setting on RobustSpring's frames, regardless of which benchmark the run used."""
    return run.manifest.provenance_on("robustspring").setting
