"""Confidence intervals of means; those of a run in reports are computed once and stored with the run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import polars as pl

from ...corruptions.registry import MEMBERS
from ...run.run import Run
from .bootstrap import LEVEL, RESAMPLES, error_intervals, log_deviation
from .sums import AVERAGE, CLEAN, INTERVAL_METRICS, ClusterSums

_SCHEMA: dict[str, Any] = {
    "metric": pl.String,
    "corruption": pl.String,
    "severity": pl.Int64,
    "estimate": pl.Float64,
    "standard_error": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "log_deviation": pl.Float64,
    "images": pl.Int64,
    "clusters": pl.Int64,
    "level": pl.Float64,
}

MetricKey = tuple[str, str, int | None]


def intervals(
    rows: pl.DataFrame,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
    severities: bool = False,
    corruptions: bool = True,
    families: bool = False,
    metrics: Sequence[str] = INTERVAL_METRICS,
) -> pl.DataFrame:
    """Compute intervals of EPE, CRE, CREr and RCRE, overall and per corruption, and of the clean EPE."""
    sums = ClusterSums.of(rows)
    keys = [key for key in statistics_of(sums, severities, corruptions, families) if key[0] in metrics]
    means = {key: sums.error_mean(*key) for key in keys}
    intervals = error_intervals(means, len(sums.clusters), level=level, resamples=resamples, seed=seed)
    shared = (sums.images, len(sums.clusters), level)
    records = [
        (*key, one.estimate, one.standard_error, one.low, one.high, log_deviation(means[key]), *shared)
        for key, one in intervals.items()
        if math.isfinite(one.estimate)
    ]
    return pl.DataFrame(records, schema=_SCHEMA, orient="row")


def statistics_of(
    sums: ClusterSums, severities: bool = False, corruptions: bool = True, families: bool = False
) -> list[MetricKey]:
    """List the (metric, corruption, severity) of every mean that can be computed from the rows."""
    keys: list[MetricKey] = [("epe", CLEAN, None)]
    for metric in INTERVAL_METRICS:
        keys += [(metric, name, None) for name in (AVERAGE, *(sums.corruptions() if corruptions else ()))]
        if families:
            keys += [(metric, name, None) for name in MEMBERS if name not in sums.corruptions()]
        if severities:
            keys += [(metric, name, level) for name, level in sums.conditions if name != CLEAN]
    return [key for key in keys if sums.measured(*key)]


IntervalEnds = tuple[float, float]
_Line = tuple[str, str, float, float]


def interval_ends(
    run: Run, corruptions: bool = True, beside_published: bool = False
) -> dict[tuple[str, str], IntervalEnds]:
    """Map (metric, corruption, family, "clean" or "average") to the ends of the 95 % interval, where one exists."""
    fewer = beside_published and more_than_paper(run)
    kind = "paper " if fewer else ""
    whole = corruptions or f"{kind}intervals" in run.derived
    name = f"{kind}{'' if whole else 'average '}intervals"
    lines = run.derived.value(name, list[_Line], lambda: _lines(run, whole, fewer))
    return {(metric, of): (low, high) for metric, of, low, high in lines if corruptions or of in (AVERAGE, CLEAN)}


def _lines(run: Run, corruptions: bool, fewer: bool) -> list[_Line]:
    rows = paper_rows(run) if fewer else run.rows
    known = intervals(rows, corruptions=corruptions, families=corruptions).drop_nulls(["low", "high"])
    return list(known.select("metric", "corruption", "low", "high").iter_rows())


def paper_rows(run: Run) -> pl.DataFrame:
    """Return the rows of the averages that are shown beside published ones."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.measured.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages include all of the paper's corruptions and additional ones."""
    measured = run.measured
    return bool(measured.paper_over) and len(measured.averaged_over) > len(measured.paper_over)
