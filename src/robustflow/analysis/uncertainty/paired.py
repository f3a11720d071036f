"""Compare two models on the same samples: differences, intervals, p-values with Holm's correction, and a sentence.

An image that is hard for one model is usually hard for the other, so differences are computed per image before
averaging, and the test is based on the spread of these differences.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from ...errors import RunError
from ...runs.comparable import common_rows
from .bootstrap import LEVEL, RESAMPLES, Interval, bootstrap
from .holm import holm
from .intervals import MetricKey, statistics_of
from .sentences import difference_sentence
from .statistic import Array
from .sums import AVERAGE, CLEAN, ClusterSums

MOST_COMPARED = 8
"""Number of the best models for which the lead of the first is tested."""

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
    "equal": pl.Int64,
    "blow_ups_first": pl.Int64,
    "blow_ups_second": pl.Int64,
    "level": pl.Float64,
    "sentence": pl.String,
}
"""`difference` is first minus second, and thus negative if the first is lower. `p_holm` is corrected for `comparisons`
tests. `equal` is the number of images on which both have the same value (for CREr, the same CRE), and `blow_ups_first`
the number of images on which the error of the first (EPE, or RCRE without ground truth) is more than `BLOW_UP` times
that of the second. `low` and `high` are null if there are too few clusters or the interval has no finite ends."""

BLOW_UP = 10.0


def compare_rows(
    first: pl.DataFrame,
    second: pl.DataFrame,
    names: tuple[str, str] = ("first", "second"),
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Test whether two models differ in clean EPE and in EPE, CRE, CREr and RCRE, on average and per corruption."""
    one, other = (_Sums.of(rows) for rows in common_rows((first, second), names)[0])
    differences = _differences(names, (one, other), statistics_of(one.clusters), level, resamples, seed)
    if not differences:
        raise RunError(
            f"{names[0]} and {names[1]} have no measured mean in common; robustflow report lists those of each"
        )
    return _table((list(of_metric) for _, of_metric in groupby(differences, lambda each: each.key[0])), level)


def compare_all(
    runs: Mapping[str, pl.DataFrame],
    metric: str = "cre",
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Compare all pairs of models on the average of one metric, corrected over all pairs (`COMPARISON_SCHEMA`)."""
    key: MetricKey = (metric, AVERAGE, None)
    common, _ = common_rows(list(runs.values()), list(runs))
    of_run = {name: _Sums.of(rows) for name, rows in zip(runs, common, strict=True)}
    pairs: list[_Difference] = []
    for first, second in combinations(of_run, 2):
        pairs += _differences((first, second), (of_run[first], of_run[second]), [key], level, resamples, seed)
    return _table([pairs], level)


def compare_leaders(runs: Mapping[str, pl.DataFrame], metric: str) -> dict[str, Any] | None:
    """Compare the two best of several models on the average of one metric, corrected for all pairs, because the two
    were selected from these models.
    """
    first, second, *_ = runs
    return next(compare_all(runs, metric).filter(first=first, second=second).iter_rows(named=True), None)


class _Sums(NamedTuple):
    """The errors of one run, added up per cluster and per image."""

    clusters: ClusterSums
    images: ClusterSums

    @classmethod
    def of(cls, rows: pl.DataFrame) -> _Sums:
        return cls(ClusterSums.of(rows), ClusterSums.of(rows.with_columns(group="sample")))

    def of_images(self, key: MetricKey) -> Array:
        """Return the error of each image, or its increase; NaN where it was not measured."""
        mean = self.images.error_mean(*key).mean
        with np.errstate(invalid="ignore"):
            return (mean.total @ mean.share) / (mean.count @ mean.share)


@dataclass(frozen=True)
class _Difference:
    """The difference between two models in one mean; `gaps` are the differences in clean EPE and average RCRE."""

    names: tuple[str, str]
    key: MetricKey
    interval: Interval
    values: tuple[float, float]
    images: int
    clusters: int
    equal: int
    blow_ups: tuple[int, int]
    gaps: tuple[float | None, float | None]


def _differences(
    names: tuple[str, str],
    sums: tuple[_Sums, _Sums],
    keys: Sequence[MetricKey],
    level: float,
    resamples: int,
    seed: int,
) -> list[_Difference]:
    first, second = (one.clusters for one in sums)
    if first.clusters != second.clusters:
        raise RunError("the two runs group their samples differently; compare runs on the same data")
    clusters = len(first.clusters)
    keys = [key for key in keys if first.measured(*key) and second.measured(*key)]
    if not keys:
        return []
    statistics = {key: first.statistic(*key) - second.statistic(*key) for key in keys}
    intervals = bootstrap(statistics, clusters, level=level, resamples=resamples, seed=seed)
    gaps = _gap(first, second, ("epe", CLEAN, None)), _gap(first, second, ("rcre", AVERAGE, None))
    differences = []
    for key, interval in intervals.items():
        if np.isfinite(interval.estimate):
            equal = int(np.count_nonzero(np.equal(*(one.of_images(key) for one in sums))))
            values = first.mean(*key), second.mean(*key)
            counts = first.images, clusters, equal, _blow_ups(sums, key)
            differences.append(_Difference(names, key, interval, values, *counts, gaps))
    return differences


def _blow_ups(sums: tuple[_Sums, _Sums], key: MetricKey) -> tuple[int, int]:
    """Count the images on which the error of one model is more than `BLOW_UP` times that of the other."""
    _, corruption, severity = key
    metric = "epe" if sums[0].clusters.measured("epe", corruption, severity) else "rcre"
    one, other = (each.of_images((metric, corruption, severity)) for each in sums)
    return int(np.count_nonzero(one > BLOW_UP * other)), int(np.count_nonzero(other > BLOW_UP * one))


def _gap(first: ClusterSums, second: ClusterSums, key: MetricKey) -> float | None:
    """Return the difference of two means (first minus second), in pixels; None if not measured."""
    return first.mean(*key) - second.mean(*key) if first.measured(*key) and second.measured(*key) else None


def _table(groups: Iterable[Sequence[_Difference]], level: float) -> pl.DataFrame:
    """Tabulate differences, with p-values corrected within each group."""
    records = []
    for group in groups:
        tested = [one.interval.p for one in group if one.interval.p is not None]
        adjusted = iter(holm(tested))
        for one in group:
            metric, corruption, _ = one.key
            interval = one.interval
            p_holm = None if interval.p is None else next(adjusted)
            counts = (one.images, one.clusters)
            sentence = difference_sentence(
                one.names,
                metric,
                corruption,
                interval,
                p_holm,
                len(tested),
                *counts,
                level,
                *one.gaps,
                equal=one.equal,
                blow_ups=one.blow_ups,
            )
            numbers = (interval.estimate, interval.low, interval.high, interval.p, p_holm, len(tested))
            about = (*counts, one.equal, *one.blow_ups, level, sentence)
            records.append((*one.names, metric, corruption, *one.values, *numbers, *about))
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA, orient="row")
