"""Confidence intervals of the means of a run, computed once and stored with the run."""

from __future__ import annotations

import polars as pl

from ..metrics.cube import AVERAGE
from ..metrics.measures import CONFIDENCE, MEASURES, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.run import Run
from .estimate import HEADLINE, OVERALL_SCOPES, cubes_of, estimate, scopes_of

IntervalEnds = tuple[float, float]
_Line = tuple[str, str, float, float]


def interval_ends(
    run: Run, corruptions: bool = True, beside_published: bool = False
) -> dict[tuple[str, str], IntervalEnds]:
    """Map (measure, condition) to the ends of the 95 % interval, where one exists: of every measure on the clean frames
    and on average, and of the headline measures for each corruption and family."""
    fewer = beside_published and more_than_paper(run)
    kind = "paper " if fewer else ""
    whole = corruptions or f"{kind}ends" in run.derived
    name = f"{kind}{'' if whole else 'average '}ends"
    lines = run.derived.value(name, list[_Line], lambda: _lines(run, whole, fewer))
    return {(measure, of): (low, high) for measure, of, low, high in lines if corruptions or of in (AVERAGE, CLEAN)}


def _lines(run: Run, corruptions: bool, fewer: bool) -> list[_Line]:
    (cube,) = cubes_of({"": paper_rows(run) if fewer else run.rows}).values()
    confident = any(run.rows[name].count() for name in ("ause", "rejected_count"))
    known = estimate(cube, MEASURES | UNCOUPLED | (CONFIDENCE if confident else {}), OVERALL_SCOPES)
    if corruptions:
        each = [scope for scope in scopes_of(cube, families=True) if scope not in OVERALL_SCOPES]
        known = pl.concat([known, estimate(cube, HEADLINE, each)])
    return list(known.drop_nulls(["low", "high"]).select("measure", "condition", "low", "high").iter_rows())


def paper_rows(run: Run) -> pl.DataFrame:
    """Return the rows of the averages that are shown beside published ones."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.measured.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages include all of the paper's corruptions and additional ones."""
    measured = run.measured
    return bool(measured.paper_over) and len(measured.averaged_over) > len(measured.paper_over)
