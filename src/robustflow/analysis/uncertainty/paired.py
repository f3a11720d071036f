"""Compare two models on the same samples: differences, intervals, p-values with Holm's correction, and a sentence.

An image that is hard for one model is usually hard for the other, so differences are computed per image before
averaging, and the test is based on the spread of these differences.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
import polars as pl

from ...errors import RunError
from ...runs.comparable import common_rows
from .bootstrap import LEVEL, RESAMPLES, Interval, bootstrap
from .holm import holm
from .intervals import MetricKey, statistics_of
from .sentences import difference_sentence
from .sums import AVERAGE, CLEAN, ClusterSums

COMPARISON_SCHEMA: dict[str, Any] = {
    "first": pl.String,
    "second": pl.String,
    "metric": pl.String,
    "corruption": pl.String,
    "value_first": pl.Float64,
    "value_second": pl.Float64,
    "difference": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "p": pl.Float64,
    "p_holm": pl.Float64,
    "comparisons": pl.Int64,
    "images": pl.Int64,
    "clusters": pl.Int64,
    "level": pl.Float64,
    "sentence": pl.String,
}
"""`difference` is first minus second, and thus negative if the first is lower. `p_holm` is corrected for `comparisons`
tests."""


def compare_rows(
    first: pl.DataFrame,
    second: pl.DataFrame,
    names: tuple[str, str] = ("first", "second"),
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Test whether two models differ in clean EPE and in EPE, CRE, CREr and RCRE, on average and per corruption.

    Only measurements on the same frames and ground truth are compared (`runs.comparable`). p-values are corrected over
    all rows of one metric.

    Args:
        first, second: rows of two runs over the same samples.
        names: names of the two models, for the sentences.
        level, resamples, seed: confidence level, number of resamples and random seed of the bootstrap.

    Returns:
        A table with the columns of `COMPARISON_SCHEMA`.

    Raises:
        RunError: if the runs have nothing in common on the same frames and ground truth.
    """
    sums = tuple(ClusterSums.of(rows) for rows in common_rows((first, second), names)[0])
    differences = _differences(sums, statistics_of(sums[0]), level, resamples, seed)
    gaps = _gaps(sums)
    by_metric: dict[str, list[MetricKey]] = {}
    for key in differences:
        by_metric.setdefault(key[0], []).append(key)
    records = []
    for keys in by_metric.values():
        adjusted = _adjusted([differences[key][0] for key in keys])
        for key, p_holm in zip(keys, adjusted, strict=True):
            records.append(_record(names, key, differences[key], p_holm, len(keys), sums[0], level, *gaps))
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA, orient="row")


def compare_all(
    runs: Mapping[str, pl.DataFrame],
    metric: str = "cre",
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Compare all pairs of models on the average of one metric, corrected over all pairs (`COMPARISON_SCHEMA`).

    Only measurements of all models on the same frames and ground truth are compared, so a model has the same value in
    every row.

    Raises:
        RunError: if the runs have nothing in common on the same frames and ground truth.
    """
    key: MetricKey = (metric, AVERAGE, None)
    common, _ = common_rows(list(runs.values()), list(runs))
    of_run = {name: ClusterSums.of(rows) for name, rows in zip(runs, common, strict=True)}
    pairs = []
    for names in combinations(of_run, 2):
        sums = (of_run[names[0]], of_run[names[1]])
        if all(one.measured(*key) for one in sums):
            pairs.append((names, sums, _differences(sums, [key], level, resamples, seed)[key]))
    adjusted = _adjusted([difference[0] for _, _, difference in pairs])
    records = [
        _record(names, key, difference, p_holm, len(pairs), sums[0], level, *_gaps(sums))
        for (names, sums, difference), p_holm in zip(pairs, adjusted, strict=True)
    ]
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA, orient="row")


_Difference = tuple[Interval, float, float]


def _differences(
    sums: tuple[ClusterSums, ...], keys: list[MetricKey], level: float, resamples: int, seed: int
) -> dict[MetricKey, _Difference]:
    first, second = sums
    if first.clusters != second.clusters:
        raise RunError("the two runs group their samples differently; compare runs on the same data")
    keys = [key for key in keys if second.measured(*key)]

    statistics = {key: first.statistic(*key) - second.statistic(*key) for key in keys}
    intervals = bootstrap(statistics, len(first.clusters), level=level, resamples=resamples, seed=seed, symmetric=True)
    whole = np.ones((1, len(first.clusters)))
    return {
        key: (
            intervals[key],
            float(first.statistic(*key)(whole).theta[0]),
            float(second.statistic(*key)(whole).theta[0]),
        )
        for key in keys
        if np.isfinite(intervals[key].estimate)
    }


def _gaps(sums: tuple[ClusterSums, ...]) -> tuple[float | None, float | None]:
    """Return the differences (first minus second) in clean EPE and average RCRE, in pixels; None if not measured."""
    whole = np.ones((1, len(sums[0].clusters)))
    gaps: list[float | None] = []
    for key in (("epe", CLEAN, None), ("rcre", AVERAGE, None)):
        if all(one.measured(*key) for one in sums):
            first, second = (float(one.statistic(*key)(whole).theta[0]) for one in sums)
            gaps.append(first - second)
        else:
            gaps.append(None)
    return gaps[0], gaps[1]


def _adjusted(intervals: list[Interval]) -> list[float | None]:
    known = [one.p for one in intervals if one.p is not None]
    corrected = iter(holm(known))
    return [None if one.p is None else next(corrected) for one in intervals]


def _record(
    names: tuple[str, str],
    key: MetricKey,
    difference: _Difference,
    p_holm: float | None,
    comparisons: int,
    sums: ClusterSums,
    level: float,
    clean_gap: float | None,
    flow_gap: float | None,
) -> tuple[Any, ...]:
    interval, value_first, value_second = difference
    numbers = (interval.estimate, interval.low, interval.high, interval.p, p_holm, comparisons)
    counts = (sums.images, len(sums.clusters), level)
    sentence = difference_sentence(names, key[0], key[1], interval, p_holm, comparisons, *counts, clean_gap, flow_gap)
    return (*names, key[0], key[1], value_first, value_second, *numbers, *counts, sentence)
