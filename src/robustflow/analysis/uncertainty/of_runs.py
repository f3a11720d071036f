"""The intervals of a run that pages show, made once and kept with it."""

from __future__ import annotations

from ...runs.run import Run
from .intervals import intervals
from .sums import AVERAGE, CLEAN

Ends = tuple[float, float]
_Line = tuple[str, str, float, float]


def interval_ends(run: Run, corruptions: bool = True) -> dict[tuple[str, str], Ends]:
    """(metric, corruption) -> the ends of the 95 % interval, where there is one; of the clean EPE and the averages
    alone without `corruptions`."""
    whole = corruptions or run.has_fact("intervals")
    lines = run.fact("intervals" if whole else "average_intervals", list[_Line], lambda: _lines(run, whole))
    return {(metric, name): (low, high) for metric, name, low, high in lines if corruptions or name in (AVERAGE, CLEAN)}


def _lines(run: Run, corruptions: bool) -> list[_Line]:
    found = intervals(run.rows, corruptions=corruptions).drop_nulls(["low", "high"])
    return list(found.select("metric", "corruption", "low", "high").iter_rows())
