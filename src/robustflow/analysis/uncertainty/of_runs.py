"""The intervals of a run that appear in reports, computed once and stored with the run."""

from __future__ import annotations

from ...runs.run import Run
from ..paper_means import more_than_paper, paper_rows
from .intervals import intervals
from .sums import AVERAGE, CLEAN

IntervalEnds = tuple[float, float]
_Line = tuple[str, str, float, float]


def interval_ends(
    run: Run, corruptions: bool = True, beside_published: bool = False
) -> dict[tuple[str, str], IntervalEnds]:
    """Map (metric, corruption, family, "clean" or "average") to the ends of the 95 % interval, where one exists."""
    fewer = beside_published and more_than_paper(run)
    kind = "paper " if fewer else ""
    whole = corruptions or run.has_cached_value(f"{kind}intervals")
    name = f"{kind}{'' if whole else 'average '}intervals"
    lines = run.cached_value(name, list[_Line], lambda: _lines(run, whole, fewer))
    return {(metric, of): (low, high) for metric, of, low, high in lines if corruptions or of in (AVERAGE, CLEAN)}


def _lines(run: Run, corruptions: bool, fewer: bool) -> list[_Line]:
    rows = paper_rows(run) if fewer else run.rows
    known = intervals(rows, corruptions=corruptions, families=corruptions).drop_nulls(["low", "high"])
    return list(known.select("metric", "corruption", "low", "high").iter_rows())
