"""Intervals of mean errors, from the studentised bootstrap on the logarithmic scale.

Errors are positive and skewed: the true mean may be far above the mean of a few images, but hardly below it. Let A be a
mean error and t* the pivots of ln A (`bootstrap`). With the jackknife's standard error s of ln A, both tails taken
together, the interval consists of the quantiles of A exp(+-t* s). The three forms of an `ErrorMean` are

    EPE, RCRE    A                        CREr    C/B - 1, from ln(C/B)        CRE    B (C/B - 1), from ln B and ln(C/B)

where C and B are the errors with and without corruption; CRE may therefore be negative.

**Heavy tails.** With few images the largest errors are missing from the data and from every resample. So s^2 is
raised to the variance that the mean would have if the upper half of its clusters were log-normal, which is

    sum_g w_g^2 (exp(v) - 1)        v = mean square of ln(x_g / median) over clusters with x_g above the median

where x_g is the mean of cluster g and w_g its share of the images. With more than `_TAIL` clusters, the data show the
tail, and only the share `_TAIL` / G of the rise is added. With fewer than `FEW` clusters, the resamples contain few
distinct values, and t* is limited to the 99 % quantile (for 95 % intervals) of Student's t.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .bootstrap import (
    BLOCK,
    LEVEL,
    RESAMPLES,
    Interval,
    Key,
    check_options,
    enough_clusters,
    resampled_pivots,
    without_interval,
)
from .statistic import Array, ErrorMean, Estimates, Mean, Statistic, of_data

FEW = 12
_TAIL = 30
_WIDEST = np.log(1e4)
"""Half the width, on the logarithmic scale, above which an interval is given up: one cluster decides the mean."""
_LARGEST = 4.0
"""Largest v, above those of real errors; otherwise the intervals of a few images could be unbounded."""


def error_intervals(
    means: Mapping[Key, ErrorMean],
    clusters: int,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> dict[Key, Interval]:
    """Compute intervals, without p-values, for several mean errors of one model from the same resamples."""
    check_options(level, resamples)
    found = {key: of_data(mean, clusters) for key, mean in means.items()}
    logarithms = {
        (key, part): logarithm
        for key, mean in means.items()
        if enough_clusters(found[key].clusters, level)
        for part, logarithm in mean.logarithms().items()
    }
    errors = _jackknife(logarithms, clusters)
    shifts: dict[Key, dict[str, tuple[float, Array]]] = {key: {} for key in means}
    for (key, part), pivots in resampled_pivots(logarithms, clusters, resamples, seed).items():
        rise = _variance_increase(means[key].mean, found[key]) if part == "size" else 0.0
        error = np.sqrt(errors[key, part] ** 2 + rise)
        center = of_data(logarithms[key, part], clusters).value
        shifts[key][part] = center, error * _widened_for_few_clusters(pivots, clusters, level)
    return {key: _interval(one, shifts[key], level) for key, one in found.items()}


def _interval(values: Estimates, shifts: Mapping[str, tuple[float, Array]], level: float) -> Interval:
    """Compute the interval from the logarithm of each part and its possible errors."""
    estimate, error = values.value, values.error
    if error == 0 and shifts:
        return Interval(estimate, error, estimate, estimate, None)
    reaches = [np.quantile(np.abs(shift), level, method="inverted_cdf") for _, shift in shifts.values()]
    if not reaches or not max(reaches) < _WIDEST:
        return without_interval(values)
    draws = np.ones(1)
    with np.errstate(over="ignore", invalid="ignore"):
        for part, (center, shift) in shifts.items():
            logarithm = center + np.concatenate([shift, -shift])
            draws = draws * (np.expm1(logarithm) if part == "growth" else np.exp(logarithm))
    low, high = np.quantile(draws[~np.isnan(draws)], [(1 - level) / 2, (1 + level) / 2], method="inverted_cdf")
    return Interval(estimate, error, float(low), float(high), None)


def _jackknife(statistics: Mapping[Key, Statistic], clusters: int) -> dict[Key, float]:
    """Compute the jackknife standard errors, leaving out one cluster at a time. The sandwich formula underestimates the
    standard error if a few large clusters dominate a mean."""
    without: dict[Key, list[Array]] = {key: [] for key in statistics}
    block = max(1, BLOCK // max(1, clusters))
    for start in range(0, clusters if statistics else 0, block):
        left_out = np.arange(start, min(start + block, clusters))
        weights = (left_out[:, None] != np.arange(clusters)).astype(np.float64)
        for key, statistic in statistics.items():
            without[key].append(statistic(weights).theta)
    with np.errstate(invalid="ignore"):
        return {key: float(np.sqrt((clusters - 1) * np.concatenate(some).var())) for key, some in without.items()}


def cluster_errors(mean: Mean) -> tuple[Array, Array]:
    """Return the mean error and the share of the images of each cluster with images, float64 (G,) each."""
    some = mean.count > 0
    return mean.total[some] / mean.count[some], mean.count[some] / mean.count.sum()


def log_deviation(mean: ErrorMean) -> float | None:
    """Return the standard deviation of the logarithms of the clusters' mean errors; None for an increase, and if an
    error is 0 or there is only one cluster."""
    errors, _ = cluster_errors(mean.mean)
    if mean.over is not None or len(errors) < 2 or errors.min() <= 0:
        return None
    return float(np.log(errors).std(ddof=1))


def _variance_increase(mean: Mean, values: Estimates) -> float:
    """Compute by how much the variance of ln(mean) would be higher with a log-normal upper half of the clusters."""
    errors, weights = cluster_errors(mean)
    order = np.argsort(errors)
    median = errors[order][np.searchsorted(np.cumsum(weights[order]), 0.5 - 1e-9)]
    upper = errors > median
    if median <= 0 or not upper.any() or values.value <= 0:
        return 0.0
    square = np.average(np.square(np.log(errors[upper] / median)), weights=weights[upper])
    rise = np.expm1(min(square, _LARGEST)) * np.square(weights).sum() - (values.error / values.value) ** 2
    return float(max(0.0, rise) * min(1.0, _TAIL / len(errors)))


def _widened_for_few_clusters(pivots: Array, clusters: int, level: float) -> Array:
    if clusters >= FEW:
        return pivots
    from scipy.special import stdtrit  # imported where it is used, because every page would wait 0.2 s for SciPy

    most = stdtrit(clusters - 1, 1 - (1 - level) / 10)
    return np.asarray(np.clip(pivots, -most, most))
