"""The studentised bootstrap (bootstrap-t) over clusters, seeded and vectorised over resamples.

Each resample draws G of the G clusters with replacement. With theta the statistic and se its standard error,
t* = (theta* - theta) / se* approximates the unknown distribution of (theta - truth) / se (Efron and Tibshirani 1993,
ch. 12), so that

    truth in [theta - q se, theta + q se]

where q is a quantile of |t*|. Both tails are estimated together, because a difference between models is nearly
symmetric. The p-value is a quantile of |t*| too: it is below a if and only if the interval of level 1 - a excludes 0,
up to the resolution of the resamples. Nothing is claimed if a statistic has images in so few clusters that resamples
without any spread are more frequent than the tail. `docs/design/uncertainty.md` reports the coverage.

**Mean errors** (`error_intervals`) are positive and skewed: the true mean may be far above the mean of a few images,
but hardly below it. Let A be a mean error and t* the pivots of ln A. With the jackknife's standard error s of ln A,
both tails taken together, the interval consists of the quantiles of A exp(+-t* s). The forms of an `ErrorMean` are

    EPE, RCRE    A                        CREr    C/B - 1, from ln(C/B)        CRE    B (C/B - 1), from ln B and ln(C/B)

where C and B are the errors with and without corruption; CRE may therefore be negative.

**Heavy tails.** With few images the largest errors are missing from the data and from every resample. So s^2 is
raised to the variance that the mean would have if the upper half of its clusters were log-normal, which is

    sum_g w_g^2 (exp(v) - 1)        v = mean square of ln(x_g / median) over clusters with x_g above the median

where x_g is the mean of cluster g and w_g its share of the images. With more than `_TAIL` clusters, the data show the
tail, and only the share `_TAIL` / G of the rise is added. Resamples without the largest errors have nearly no spread,
so t* is limited to the 99 % quantile (for 95 % intervals) of Student's t.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..core.errors import UsageError
from ..core.rng import Rng
from .statistic import Array, ErrorMean, Estimates, Mean, Statistic, of_data

RESAMPLES = 4999
LEVEL = 0.95
_WIDEST = 100
"""Half the width, in standard errors, above which an interval is given up: in most resamples, nearly all clusters are
equal."""
BLOCK = 2**17
"""Number of weights in one block of resamples, so that a block and what is computed from it stay in the cache."""

_TAIL = 30
_WIDEST_LOGARITHM = np.log(1e3)
"""Half the width, on the logarithmic scale, above which an interval is given up: one cluster decides the mean."""
_LARGEST = 4.0
"""Largest v, above those of real errors; otherwise the intervals of a few images could be unbounded."""

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Interval:
    """An estimate and its uncertainty."""

    estimate: float
    standard_error: float | None
    low: float | None
    high: float | None
    p: float | None


def bootstrap(
    statistics: Mapping[Key, Statistic],
    clusters: int,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> dict[Key, Interval]:
    """Compute symmetric intervals and p-values for several statistics from the same data and the same resamples."""
    check_options(level, resamples)
    found = {key: of_data(statistic, clusters) for key, statistic in statistics.items()}
    tested = {key: one for key, one in statistics.items() if enough_clusters(found[key].clusters, level)}
    pivots = resampled_pivots(tested, clusters, resamples, seed)
    return {
        key: _symmetric_interval(one, pivots[key], level) if key in tested else without_interval(one)
        for key, one in found.items()
    }


def resampled_pivots(statistics: Mapping[Key, Statistic], clusters: int, resamples: int, seed: int) -> dict[Key, Array]:
    """Return the pivots of statistics in the same resamples."""
    centers = {key: of_data(statistic, clusters).value for key, statistic in statistics.items()}
    weights = resampled_weights(clusters, resamples, seed)
    return _in_blocks(statistics, weights, lambda key, estimates: pivots_of(estimates, centers[key]))


def _in_blocks(
    statistics: Mapping[Key, Statistic], blocks: Iterable[Array], take: Callable[[Key, Estimates], Array]
) -> dict[Key, Array]:
    """Compute statistics for blocks of weights, and join what is taken from their estimates."""
    taken: dict[Key, list[Array]] = {key: [] for key in statistics}
    for weights in blocks if statistics else ():
        for key, statistic in statistics.items():
            taken[key].append(take(key, statistic(weights)))
    return {key: np.concatenate(parts) for key, parts in taken.items()}


def check_options(level: float, resamples: int) -> None:
    """Raise `UsageError` if the level or the number of resamples is out of range."""
    if not 0.5 <= level < 1:
        raise UsageError("level", f"{level:g} is not a confidence level: it must be at least 0.5 and below 1")
    if not 99 <= resamples <= 1_000_000:
        raise UsageError("resamples", f"{resamples} is out of range: give a number from 99 to 1000000")


def enough_clusters(clusters: int, level: float = LEVEL) -> bool:
    """Whether resamples that draw only a single cluster, and so have no spread, are less frequent than the tail.

    >>> enough_clusters(3), enough_clusters(4)
    (False, True)
    """
    return clusters > 1 and float(clusters) ** (1 - clusters) < 1 - level


def fewest_clusters(level: float = LEVEL) -> int:
    """Return the smallest number of clusters for which an interval exists.

    >>> fewest_clusters()
    4
    """
    return next(count for count in range(2, 10_000) if enough_clusters(count, level))


def resampled_weights(clusters: int, resamples: int, seed: int) -> Iterator[Array]:
    """Yield blocks of the number of times that each cluster is drawn, float64 (B, G)."""
    stream = Rng.of(seed, "bootstrap", clusters)
    block = max(1, BLOCK // clusters)
    for start in range(0, resamples, block):
        count = min(block, resamples - start)
        drawn = (stream.uniforms(count * clusters) * clusters).astype(np.int64)
        place = np.repeat(np.arange(count) * clusters, clusters) + drawn
        yield np.bincount(place, minlength=count * clusters).reshape(count, clusters).astype(np.float64)


def pivots_of(estimates: Estimates, center: float) -> Array:
    """Compute t* of each resample: 0 where the resample equals the data, infinite where it has no spread, NaN without
    images."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shift, spread = estimates.theta - center, estimates.standard_error
        tiny = 1e-12 * max(abs(center), float(np.nanmax(np.abs(shift), initial=0.0)))
        pivots = np.where(spread > tiny, shift / spread, np.sign(shift) * np.inf)
    return np.asarray(np.where(np.abs(shift) <= tiny, 0.0, pivots))


def _symmetric_interval(values: Estimates, pivots: Array, level: float) -> Interval:
    estimate, error = values.value, values.error
    if not np.isfinite(estimate) or not np.isfinite(error):
        return without_interval(values)
    sizes = np.abs(pivots[~np.isnan(pivots)])
    observed = abs(estimate) / error if error > 0 else np.inf
    p = float(1 + np.count_nonzero(sizes >= observed)) / (len(sizes) + 1)
    if error == 0:
        return Interval(estimate, 0.0, estimate, estimate, 1.0 if estimate == 0 else p)
    reach = float(np.quantile(sizes, level, method="inverted_cdf")) * error
    if not reach < _WIDEST * error:
        return Interval(estimate, error, None, None, p)
    return Interval(estimate, error, estimate - reach, estimate + reach, p)


def without_interval(values: Estimates) -> Interval:
    """Return an estimate and its standard error without ends and p-value."""
    return Interval(values.value, values.error if np.isfinite(values.error) else None, None, None, None)


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
        shifts[key][part] = center, error * _limited(pivots, clusters, level)
    return {key: _logarithmic_interval(one, shifts[key], level) for key, one in found.items()}


def _logarithmic_interval(values: Estimates, shifts: Mapping[str, tuple[float, Array]], level: float) -> Interval:
    """Compute the interval from the logarithm of each part and its possible errors."""
    estimate, error = values.value, values.error
    if error == 0 and shifts:
        return Interval(estimate, error, estimate, estimate, None)
    reaches = [np.quantile(np.abs(shift), level, method="inverted_cdf") for _, shift in shifts.values()]
    if not reaches or not np.max(reaches) < _WIDEST_LOGARITHM:  # NaN where an error is 0
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
    without = _in_blocks(statistics, _weights_without_one(clusters), lambda _, estimates: estimates.theta)
    with np.errstate(invalid="ignore"):
        return {key: float(np.sqrt((clusters - 1) * values.var())) for key, values in without.items()}


def _weights_without_one(clusters: int) -> Iterator[Array]:
    block = max(1, BLOCK // clusters)
    for start in range(0, clusters, block):
        left_out = np.arange(start, min(start + block, clusters))
        yield (left_out[:, None] != np.arange(clusters)).astype(np.float64)


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


def _limited(pivots: Array, clusters: int, level: float) -> Array:
    from scipy.special import stdtrit  # imported where it is used, because every page would wait 0.2 s for SciPy

    most = stdtrit(clusters - 1, 1 - (1 - level) / 10)
    return np.asarray(np.clip(pivots, -most, most))
