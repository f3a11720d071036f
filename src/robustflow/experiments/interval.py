"""Interval and p-value of a mean difference for other pairs and other seeds, by a bootstrap over both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_PAIRS, FEWEST_SEEDS = 10, 4
"""Below which there is neither interval nor p-value."""
_LEVEL = 0.95
_RESAMPLES = 4000


class Interval(NamedTuple):
    """95 % interval of a mean, and the two-sided p-value for a mean of 0."""

    low: float
    high: float
    p: float


def interval(differences: Array) -> Interval | None:
    """The interval of the mean, for other seeds and other pairs.

    A bootstrap-t (Efron and Tibshirani 1993, ch. 12): seeds and pairs are both resampled, as in Owen (2007), and each
    resample's mean is divided by its own standard error, so that skewed pairs and few seeds widen the interval where
    they should.

    Args:
        differences: (seeds, pairs).

    Returns:
        None with fewer than `FEWEST_PAIRS` pairs or `FEWEST_SEEDS` seeds.

    >>> values = np.random.default_rng(0).normal(1.0, 0.5, (6, 50))
    >>> found = interval(values)
    >>> found.low < 1.0 < found.high, found.p < 0.01
    (True, True)
    >>> interval(values[:, :5]) is None
    True
    """
    seeds, pairs = differences.shape
    if seeds < FEWEST_SEEDS or pairs < FEWEST_PAIRS:
        return None
    mean = float(differences.mean())
    ones = np.ones((1, seeds)), np.ones((1, pairs))
    error = float(_standard_errors(differences, *ones)[1][0])
    if error == 0:
        return Interval(mean, mean, 1.0 if mean == 0 else 0.0)
    rng = np.random.default_rng(0)
    of_seeds = rng.multinomial(seeds, np.full(seeds, 1 / seeds), _RESAMPLES).astype(float)
    of_pairs = rng.multinomial(pairs, np.full(pairs, 1 / pairs), _RESAMPLES).astype(float)
    means, errors = _standard_errors(differences, of_seeds, of_pairs)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (means - mean) / errors
    ratios = ratios[np.isfinite(ratios)]
    low, high = np.quantile(ratios, [(1 + _LEVEL) / 2, (1 - _LEVEL) / 2])
    own = mean / error
    beyond = min((ratios >= own).sum(), (ratios <= own).sum())
    return Interval(mean - low * error, mean - high * error, min(1.0, 2 * (beyond + 1) / (len(ratios) + 1)))


def _standard_errors(differences: Array, of_seeds: Array, of_pairs: Array) -> tuple[Array, Array]:
    """Weighted means and their standard errors, for weights of (resamples, seeds) and (resamples, pairs)."""
    seeds, pairs = differences.shape
    by_seed = of_pairs @ differences.T / pairs
    by_pair = of_seeds @ differences / seeds
    means = (of_seeds * by_seed).sum(axis=1) / seeds
    over_seeds = (of_seeds * (by_seed - means[:, None]) ** 2).sum(axis=1) / (seeds - 1) / seeds
    over_pairs = (of_pairs * (by_pair - means[:, None]) ** 2).sum(axis=1) / (pairs - 1) / pairs
    return means, np.sqrt(over_seeds + over_pairs)
