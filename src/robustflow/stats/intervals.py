"""Confidence intervals of the means of a run, computed once and stored with the run."""

from __future__ import annotations

import polars as pl

from ..metrics.cube import AVERAGE
from ..metrics.measures import CONFIDENCE, MEASURES, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.run import Run
from .estimate import HEADLINE, OVERALL_SCOPES, cubes_of, estimate, scopes_of

IntervalEnds = tuple[float, float]
ESTIMATED = ("measure", "condition", "severity", "low", "high", "log_deviation")
Estimate = tuple[str, str, int | None, float | None, float | None, float | None]
"""The columns `ESTIMATED` of a mean: what it is of, the ends of its 95 % interval, and the spread of the errors."""

BY_SEVERITY = {name: MEASURES[name] for name in ("epe", "rcre")}
"""The measures of which curves by severity have intervals."""


def interval_ends(
    run: Run, corruptions: bool = True, beside_published: bool = False
) -> dict[tuple[str, str, int | None], IntervalEnds]:
    """Map (measure, condition, severity) to the ends of the 95 % interval, where one exists."""
    estimates = estimates_of(run, corruptions, beside_published)
    return {
        (measure, of, at): (low, high)
        for measure, of, at, low, high, _ in estimates
        if low is not None and high is not None
    }


def estimates_of(run: Run, corruptions: bool = True, beside_published: bool = False) -> list[Estimate]:
    """Return the uncertainty of every measure on the clean frames and on average and, with `corruptions`, of the
    headline measures for each corruption and family, and of EPE and RCRE at each severity."""
    fewer = beside_published and more_than_paper(run)
    kind = "paper " if fewer else ""
    whole = corruptions or f"{kind}estimates" in run.derived
    name = f"{kind}{'' if whole else 'average '}estimates"
    lines = run.derived.value(name, list[Estimate], lambda: _lines(run, whole, fewer))
    return [tuple(line) for line in lines if corruptions or line[1] in (AVERAGE, CLEAN)]  # type: ignore[misc]


def _lines(run: Run, corruptions: bool, fewer: bool) -> list[Estimate]:
    (cube,) = cubes_of({"": paper_rows(run) if fewer else run.rows}).values()
    confident = any(run.rows[name].count() for name in ("ause", "rejected_count"))
    known = [estimate(cube, MEASURES | UNCOUPLED | (CONFIDENCE if confident else {}), OVERALL_SCOPES)]
    if corruptions:
        scopes = scopes_of(cube, families=True, severities=True)
        known.append(estimate(cube, HEADLINE, [at for at in scopes if at[1] is None and at not in OVERALL_SCOPES]))
        known.append(estimate(cube, BY_SEVERITY, [at for at in scopes if at[1] is not None]))
    every = pl.concat(known).select(ESTIMATED)
    return list(every.filter(pl.any_horizontal(pl.col(ESTIMATED[3:]).is_not_null())).iter_rows())


def paper_rows(run: Run) -> pl.DataFrame:
    """Return the rows of the averages that are shown beside published ones."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.measured.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages include all of the paper's corruptions and additional ones."""
    measured = run.measured
    return bool(measured.paper_over) and len(measured.averaged_over) > len(measured.paper_over)
