"""The studentised bootstrap (bootstrap-t) over clusters, seeded and vectorised over resamples.

Each resample draws G of the G clusters with replacement. With theta the statistic and se its standard error,
t* = (theta* - theta) / se* approximates the unknown distribution of (theta - truth) / se, so that

    truth in [theta - q_{1 - a/2} se, theta - q_{a/2} se]

where q are the quantiles of t* (Efron and Tibshirani 1993, ch. 12). The p-value is a quantile of |t*|: it is below a if
and only if the symmetric interval of level 1 - a excludes 0, up to the resolution of the resamples.

Errors are skewed, so the two tails of a mean are estimated separately. In three cases they are estimated together
(quantiles of |t*|, a symmetric interval): for a difference between models, which is nearly symmetric and whose test
would otherwise reject too often; for CREr, a ratio of two means, where ln(1 + CREr) is studentised with a jackknife
standard error; and for fewer than `FEW` clusters, where a single tail would contain too few distinct resamples. There
is no interval if there are so few clusters that resamples without any spread are more frequent than the tail.
`docs/design/uncertainty.md` reports the coverage.
"""

from __future__ import annotations

from collections.abc import Container, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ...errors import UsageError
from ...random.rng import Rng
from .statistic import Array, Statistic, StatisticValues

FEW = 12
RESAMPLES = 4999
LEVEL = 0.95
_BLOCK = 2**22
"""Number of weights in one block. Resamples are drawn in blocks to limit memory use."""

_WIDTH = 512
"""Maximum number of columns to multiply by the weights at a time."""

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Interval:
    """An estimate and its uncertainty.

    Attributes:
        estimate: value of the statistic on the data.
        standard_error: standard error of the estimate; None for a single cluster.
        low, high: ends of the interval; None if there are too few clusters.
        p: two-sided p-value for the hypothesis that the statistic is 0; None if there are too few clusters.
    """

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
    symmetric: bool = False,
    relative: Container[Key] = (),
) -> dict[Key, Interval]:
    """Compute intervals and p-values for several statistics from the same data and the same resamples.

    Args:
        statistics: name -> statistic; all statistics must be over the same clusters.
        clusters: number of clusters, G.
        level: confidence level of the intervals, at least 0.5 and below 1.
        resamples: number of resamples; the p-value cannot be below 1 / (resamples + 1).
        seed: random seed; the same seed gives the same resamples.
        symmetric: whether to estimate both tails together, as for differences.
        relative: names of the statistics that are increases relative to a mean, such as CREr. For these, ln(1 +
            statistic) is studentised and both tails are estimated together.

    Raises:
        UsageError: if the level or the number of resamples is out of range.

    >>> import numpy as np
    >>> from robustflow.analysis.uncertainty.statistic import Mean, Statistic, Term
    >>> errors = Mean(np.linspace(1, 3, 30)[:, None], np.ones((30, 1)), np.ones(1))
    >>> one = bootstrap({"mean": Statistic([Term(errors)])}, 30)["mean"]
    >>> one.low < 2 < one.high and one.p < 0.01
    True
    """
    if not 0.5 <= level < 1:
        raise UsageError(f"a level of {level:g} is not a confidence level: it must be at least 0.5 and below 1")
    if not 99 <= resamples <= 1_000_000:
        raise UsageError(f"{resamples} resamples is out of range: give a number from 99 to 1000000")
    whole = np.ones((1, clusters))
    estimates_of = {key: statistic(whole) for key, statistic in statistics.items()}
    if not enough_clusters(clusters, level):
        return {key: _without_interval(estimates) for key, estimates in estimates_of.items()}
    logarithms = {key: _logarithm(values) for key, values in estimates_of.items() if key in relative}
    errors = _jackknife({key: statistics[key] for key in logarithms}, clusters)
    pivots: dict[Key, list[Array]] = {key: [] for key in statistics}
    for weights in _resamples(clusters, resamples, seed):
        for key, values in _values(statistics, weights):
            if key in logarithms:
                pivots[key].append(_pivots(_logarithm(values), logarithms[key].theta[0]))
            else:
                pivots[key].append(_pivots(values, estimates_of[key].theta[0]))
    together = symmetric or clusters < FEW
    intervals = {}
    for key, values in estimates_of.items():
        made = np.concatenate(pivots[key])
        if key in logarithms:
            logarithm = logarithms[key]._replace(standard_error=errors[key])
            intervals[key] = _exponential(_interval(logarithm, made, True, level), values)
        else:
            intervals[key] = _interval(values, made, together, level)
    return intervals


def _logarithm(values: StatisticValues) -> StatisticValues:
    """Compute ln(1 + statistic) and its standard error to first order; NaN for statistics of at most -1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return StatisticValues(np.log1p(values.theta), values.standard_error / (1 + values.theta))


def _jackknife(statistics: Mapping[Key, Statistic], clusters: int) -> dict[Key, Array]:
    """Compute the jackknife standard error of each `_logarithm`, leaving out one cluster at a time. The sandwich
    formula underestimates the standard error if a few large clusters dominate a mean."""
    without: dict[Key, list[Array]] = {key: [] for key in statistics}
    block = max(1, _BLOCK // clusters)
    for start in range(0, clusters if statistics else 0, block):
        left_out = np.arange(start, min(start + block, clusters))
        weights = (left_out[:, None] != np.arange(clusters)).astype(np.float64)
        for key, values in _values(statistics, weights):
            without[key].append(_logarithm(values).theta)
    return {key: np.sqrt([(clusters - 1) * np.concatenate(parts).var()]) for key, parts in without.items()}


def _exponential(interval: Interval, values: StatisticValues) -> Interval:
    """Convert the interval of a `_logarithm` to the interval of the statistic."""
    if interval.low is None or interval.high is None:
        return _without_interval(values)
    ends = float(np.expm1(interval.low)), float(np.expm1(interval.high))
    return Interval(float(values.theta[0]), float(values.standard_error[0]), *ends, interval.p)


def _values(statistics: Mapping[Key, Statistic], weights: Array) -> Iterator[tuple[Key, StatisticValues]]:
    """Yield the values of each statistic; the products with the weights are computed for many statistics together."""
    keys = list(statistics)
    while keys:
        width = 0
        some: list[Key] = []
        while keys and (not some or width + statistics[keys[0]].columns.shape[1] <= _WIDTH):
            some.append(keys.pop(0))
            width += statistics[some[-1]].columns.shape[1]
        products = weights @ np.concatenate([statistics[key].columns for key in some], axis=1)
        start = 0
        for key in some:
            end = start + statistics[key].columns.shape[1]
            yield key, statistics[key].values(weights, products[:, start:end])
            start = end


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


def _resamples(clusters: int, resamples: int, seed: int) -> Iterator[Array]:
    stream = Rng.of(seed, "bootstrap", clusters)
    block = max(1, _BLOCK // clusters)
    for start in range(0, resamples, block):
        count = min(block, resamples - start)
        drawn = (stream.uniforms(count * clusters) * clusters).astype(np.int64)
        place = np.repeat(np.arange(count) * clusters, clusters) + drawn
        yield np.bincount(place, minlength=count * clusters).reshape(count, clusters).astype(np.float64)


def _pivots(estimates: StatisticValues, center: float) -> Array:
    """Compute t* of each resample: 0 where the resample equals the data, infinite where it has no spread."""
    shift, spread = estimates.theta - center, estimates.standard_error
    tiny = 1e-12 * max(abs(center), float(np.nanmax(np.abs(shift), initial=0.0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        pivots = np.where(spread > tiny, shift / spread, np.sign(shift) * np.inf)
    return np.asarray(np.where(np.abs(shift) <= tiny, 0.0, pivots)[np.isfinite(shift)])


def _interval(values: StatisticValues, pivots: Array, symmetric: bool, level: float) -> Interval:
    estimate, error = float(values.theta[0]), float(values.standard_error[0])
    if not np.isfinite(estimate) or not np.isfinite(error):
        return _without_interval(values)
    observed = estimate / error if error > 0 else float(np.sign(estimate)) * np.inf
    if symmetric:
        reach = np.quantile(np.abs(pivots), level, method="inverted_cdf")
        below, above = -reach, reach
    else:
        below, above = np.quantile(pivots, [(1 - level) / 2, (1 + level) / 2], method="inverted_cdf")
    p = float(1 + np.count_nonzero(np.abs(pivots) >= abs(observed))) / (len(pivots) + 1)
    if error == 0:
        return Interval(estimate, 0.0, estimate, estimate, 1.0 if estimate == 0 else p)
    if not np.isfinite([below, above]).all():
        return _without_interval(values)
    return Interval(estimate, error, float(estimate - above * error), float(estimate - below * error), p)


def _without_interval(values: StatisticValues) -> Interval:
    error = float(values.standard_error[0])
    return Interval(float(values.theta[0]), error if np.isfinite(error) else None, None, None, None)
