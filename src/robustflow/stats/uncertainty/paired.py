"""Correct p-values for multiple comparisons. Describe in one sentence what can be claimed about a difference.
Compare two models on the same samples: differences, intervals, p-values with Holm's correction, and a sentence.

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

from ...core.errors import RunError
from ...core.text import counted
from ...run.comparable import common_rows
from ..results import METRIC_LABELS, UNITS, long_label
from .bootstrap import LEVEL, RESAMPLES, Interval, bootstrap
from .intervals import MetricKey, statistics_of
from .statistic import Array
from .sums import AVERAGE, CLEAN, ClusterSums


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values by Holm's step-down method (Holm 1979). Rejecting every hypothesis whose adjusted p-value is
    below a level keeps the probability of any false rejection below this level, regardless of the dependence
    between the tests.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def difference_sentence(
    names: tuple[str, str],
    metric: str,
    corruption: str,
    interval: Interval,
    p_holm: float | None,
    comparisons: int,
    images: int,
    clusters: int,
    level: float,
    clean_gap: float | None = None,
    flow_gap: float | None = None,
    *,
    equal: int = 0,
    blow_ups: tuple[int, int] = (0, 0),
) -> str:
    """Describe whether two models differ, by how much, with what certainty, and based on how many independent
    observations.

    >>> sure = Interval(-0.42, 0.1, -0.7, -0.1, 0.001)
    >>> sentence = difference_sentence(("A", "B"), "cre", "average", sure, 0.02, 1, 80, 80, 0.95, 18.0)
    >>> sentence.partition(" (")[0]
    'The average CRE of A is lower than that of B by 0.42 px'
    >>> sentence.partition("): ")[2]
    'the error of A grows less under corruption, but A is less accurate: EPE +18.00 px.'
    """
    what = {"average": "average ", "clean": "clean "}.get(corruption, f"{long_label(corruption)} ") + METRIC_LABELS[
        metric
    ]
    unit = f" {UNITS[metric]}" if UNITS[metric] else ""
    observed = f"{images} images" if clusters == images else f"{images} images in {clusters} sequences"
    size = abs(interval.estimate)
    if p_holm is None:
        units = ("image" if clusters == images else "sequence") + (" is" if clusters == 1 else "s are")
        outcome = f"differs by {size:.2f}{unit}, but" if size else "is the same, but"
        chance = "to tell whether this is chance" if size else "to say more"
        return f"The {what} of {names[0]} and {names[1]} {outcome} {clusters} {units} too few {chance}."
    percent = f"{100 * level:g} %"
    corrected = f" corrected for {comparisons} comparisons" if comparisons > 1 else ""
    evidence = f"p {p_text(p_holm)}{corrected}; {observed}"
    blown = "".join(
        f" On {counted(count, 'image')}, the error of {model} is more than ten times that of {other}."
        for count, model, other in zip(blow_ups, names, reversed(names), strict=True)
        if count
    )
    ends = "no finite interval"
    if interval.low is not None and interval.high is not None:
        ends = f"{percent} interval {interval.low:+.2f} to {interval.high:+.2f}"
    elif equal:
        ends += f", because {equal} of {counted(images, 'image')} are equal"
    if p_holm >= 1 - level or interval.low is None or interval.high is None:
        return (
            f"No difference in {what} between {names[0]} and {names[1]} can be claimed: {interval.estimate:+.2f}{unit} "
            f"({ends}; {evidence}).{blown}"
        )
    lower = interval.estimate < 0
    low, high = sorted((abs(interval.low), abs(interval.high)))
    gaps = [gap if lower or gap is None else -gap for gap in (clean_gap, flow_gap)]
    verdict = _verdict(metric, names[0] if lower else names[1], *gaps)
    return (
        f"The {what} of {names[0]} is {'lower' if lower else 'higher'} than that of {names[1]} by {size:.2f}{unit} "
        f"({percent} interval {low:.2f} to {high:.2f}; {evidence}): {verdict}.{blown}"
    )


def _verdict(metric: str, lower: str, clean_gap: float | None, flow_gap: float | None) -> str:
    """Explain what the lower value means. Each gap is the value of the model that `lower` names minus that of the other
    model. Only RCRE measures how much a flow changes."""
    if metric == "epe":
        return f"{lower} is more accurate"
    if metric == "rcre":
        clause = f"the flow of {lower} changes less under corruption"
    else:
        relative = " relative to its error on clean frames" if metric == "crer" else ""
        clause = f"the error of {lower} grows less under corruption{relative}"
        if flow_gap is not None and flow_gap >= 0.005:
            clause += f", although its flow changes more (RCRE {flow_gap:+.2f} px)"
    if clean_gap is None:
        return clause
    if abs(clean_gap) < 0.005:
        return f"{clause}, and {lower} is as accurate on clean frames"
    how = f"but {lower} is less" if clean_gap > 0 else f"and {lower} is more"
    return f"{clause}, {how} accurate: EPE {clean_gap:+.2f} px"


def p_text(value: float) -> str:
    """Format a p-value as written after the letter p; values below 0.001 are written as "< 0.001".

    >>> p_text(0.0204), p_text(0.0004)
    ('= 0.020', '< 0.001')
    """
    return "< 0.001" if value < 0.001 else f"= {value:.3f}"


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
