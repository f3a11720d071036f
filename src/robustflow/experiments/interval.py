"""Confidence interval and p-value of a mean difference, by a bootstrap over pairs and seeds."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import stdtr, stdtrit

Array = npt.NDArray[np.float64]

FEWEST_PAIRS, FEWEST_SEEDS = 10, 3
"""Minimum numbers of pairs and seeds for an interval and a p-value."""
_LEVEL = 0.95
_RESAMPLES = 4000


class MeanInterval(NamedTuple):
    """Standard error of a mean and its degrees of freedom, the 95 % interval, and the two-sided p-value for the
    hypothesis that the mean is 0."""

    error: float
    freedom: float
    low: float
    high: float
    p: float


def interval(differences: Array, resamples: int = _RESAMPLES) -> MeanInterval | None:
    """Return the confidence interval of the mean over seeds and pairs."""
    seeds, pairs = differences.shape
    if seeds < FEWEST_SEEDS or pairs < FEWEST_PAIRS:
        return None
    mean, of_seeds, of_pairs = (
        float(part[0]) for part in _variances(differences, np.ones((1, seeds)), np.ones((1, pairs)))
    )
    error = math.sqrt(of_seeds + of_pairs)
    if error == 0:
        return MeanInterval(0.0, math.inf, mean, mean, float(mean == 0))
    freedom = error**4 / (of_seeds**2 / (seeds - 1) + of_pairs**2 / (pairs - 1))
    ratios = _bootstrapped(differences, mean, resamples)
    low, high = np.quantile(ratios, [(1 + _LEVEL) / 2, (1 - _LEVEL) / 2])
    reach = float(stdtrit(freedom, (1 + _LEVEL) / 2))
    beyond = min((ratios >= mean / error).sum(), (ratios <= mean / error).sum())
    p = max(2 * (beyond + 1) / (len(ratios) + 1), 2 * stdtr(freedom, -abs(mean / error)))
    ends = mean - max(float(low), reach) * error, mean - min(float(high), -reach) * error
    return MeanInterval(error, freedom, *ends, min(1.0, float(p)))


def _bootstrapped(differences: Array, mean: float, resamples: int) -> Array:
    """Return the errors of resampled means divided by their standard errors."""
    means, of_seeds, of_pairs = _variances(differences, *(_weights(count, resamples) for count in differences.shape))
    errors = np.sqrt(of_seeds + of_pairs)
    return (means - mean)[errors > 0] / errors[errors > 0]


@cache
def _weights(count: int, resamples: int) -> Array:
    """Return how often each of `count` items is drawn in each resample, (resamples, count)."""
    return np.random.default_rng(count).multinomial(count, np.full(count, 1 / count), resamples).astype(float)


def _variances(differences: Array, seed_weights: Array, pair_weights: Array) -> tuple[Array, Array, Array]:
    """Return weighted means and their variances over seeds and over pairs, for weights of shape (resamples, seeds) and
    (resamples, pairs)."""
    seeds, pairs = differences.shape
    by_seed = pair_weights @ differences.T / pairs
    by_pair = seed_weights @ differences / seeds
    means = (seed_weights * by_seed).sum(axis=1) / seeds
    over_seeds = (seed_weights * (by_seed - means[:, None]) ** 2).sum(axis=1) / (seeds - 1) / seeds
    over_pairs = (pair_weights * (by_pair - means[:, None]) ** 2).sum(axis=1) / (pairs - 1) / pairs
    return means, over_seeds, over_pairs
