"""The studentised bootstrap (bootstrap-t) over clusters, seeded and vectorised over resamples.

Each resample draws G of the G clusters with replacement. With theta the statistic and se its standard error,
t* = (theta* - theta) / se* approximates the unknown distribution of (theta - truth) / se (Efron and Tibshirani 1993,
ch. 12), so that

    truth in [theta - q se, theta + q se]

where q is a quantile of |t*|. Both tails are estimated together, because a difference between models is nearly
symmetric. The p-value is a quantile of |t*| too: it is below a if and only if the interval of level 1 - a excludes 0,
up to the resolution of the resamples. Nothing is claimed if a statistic has images in so few clusters that resamples
without any spread are more frequent than the tail. `log_scale` computes the intervals of mean errors, which are skewed.
`docs/design/uncertainty.md` reports the coverage.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ...core.errors import UsageError
from ...core.rng import Rng
from .statistic import Array, Estimates, Statistic, of_data

RESAMPLES = 4999
LEVEL = 0.95
_WIDEST = 100
"""Half the width, in standard errors, above which an interval is given up: in most resamples, nearly all clusters are
equal."""
BLOCK = 2**17
"""Number of weights in one block of resamples, so that a block and what is computed from it stay in the cache."""

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
        key: _interval(one, pivots[key], level) if key in tested else without_interval(one)
        for key, one in found.items()
    }


def resampled_pivots(statistics: Mapping[Key, Statistic], clusters: int, resamples: int, seed: int) -> dict[Key, Array]:
    """Return the pivots of statistics in the same resamples."""
    centers = {key: of_data(statistic, clusters).value for key, statistic in statistics.items()}
    pivots: dict[Key, list[Array]] = {key: [] for key in statistics}
    for weights in resampled_weights(clusters, resamples, seed) if statistics else ():
        for key, statistic in statistics.items():
            pivots[key].append(pivots_of(statistic(weights), centers[key]))
    return {key: np.concatenate(parts) for key, parts in pivots.items()}


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


def _interval(values: Estimates, pivots: Array, level: float) -> Interval:
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
