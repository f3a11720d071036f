"""Intervals of means and paired tests, from one pair of numbers a cluster.

A cluster is a video sequence, a drive, or a single image where images are independent. Whatever a mean averages over,
its clusters enter as `Scores`: `num` (what each cluster adds to the mean) and `den` (its share of the images):

    mean = sum(num)        sum(den) = 1        value of a cluster = num / den

**Intervals** of a mean of positive errors are those of a log-normal mean (Cox's method, Land 1972). With s2 the
variance of the logarithms of the clusters, ln(mean) has the variance s2 / n + s2^2 / (2 (n - 1)), and at least that of
the data. s2 is the average of the variance and of twice the upper semivariance, because only the upper tail can raise
the mean; values below `FLOOR` of the mean count as that much, because they say nothing about this tail. A mean whose
values may be negative (CRE, a difference of models) is the difference of its positive and its negative part, whose
intervals are joined by MOVER (Zou and Donner 2008); where both signs occur, the interval is at least Student's. A ratio
(CREr) is joined likewise, from its logarithm. Percentages have Student's interval on the logistic scale, which stays
within their bounds.

**Tests** flip the signs of the clusters' differences. If two models are exchangeable, each flip is as likely as what
was observed, so the p-value is the share of flips with at least the same difference. All flips count up to `LISTED`
clusters, and `FLIPS` random ones above. Several hypotheses are adjusted by the step-down minimum of p over the same
flips (Westfall and Young 1993), which is never above Holm's. The interval of the ratio of two means inverts the test:
that of A against r B depends on the subsets of clusters in which A / B is below r, so its ends are order statistics of
the ratios of subsets (Hartigan 1969).

`docs/design/uncertainty.md` reports coverage, size and power, measured by `python bench/uncertainty.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..core.rng import Rng

Array = npt.NDArray[np.float64]

LEVEL = 0.95
FEWEST = 6
"""Clusters below which nothing is concluded: with five, no flip test can reach 5 %, and no interval covers."""
FLOOR, INCREASE_FLOOR = 0.10, 0.15
"""Share of the mean below which values count as equally small: of errors and differences of models, and of increases,
whose smallest values are noise around zero."""
LISTED = 14
"""Largest number of clusters of which all flips are listed (8 192 of them; the other half mirrors them)."""
FLIPS = 9_999
_CORRELATION = 0.7
"""Share of the correlation of numerator and denominator that is trusted: few clusters exaggerate it."""
_BLOCK = 2**20
"""Number of signs in a block of flips."""
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Scores:
    """What each cluster adds to a mean, and its share of the images.

    Attributes:
        num: float64 (..., G); the mean is the sum over clusters.
        den: float64 (G,), with the sum 1; 0 for a cluster without images.
    """

    num: Array
    den: Array

    @property
    def mean(self) -> Array:
        """float64 (...)."""
        return np.asarray(self.num.sum(axis=-1))

    @property
    def clusters(self) -> int:
        """The number of clusters with images."""
        return int(np.count_nonzero(self.den))

    @property
    def effective(self) -> float:
        """The number of clusters of equal size with the same information."""
        return float(1 / np.square(self.den).sum())

    @property
    def enough(self) -> bool:
        """Whether there are enough clusters for an interval."""
        return self.clusters >= FEWEST and self.effective > FEWEST - 1

    @property
    def error(self) -> Array:
        """float64 (...), the standard error of the mean by the sandwich formula."""
        residual = self.num - self.mean[..., None] * self.den
        count = self.clusters
        return np.asarray(np.sqrt(count / max(1, count - 1) * np.square(residual).sum(axis=-1)))

    def __sub__(self, other: Scores) -> Scores:
        return Scores(self.num - other.num, self.den)


def _quantile(count: float, lost: int, level: float = LEVEL) -> float:
    from scipy.special import stdtrit  # imported late: SciPy would delay every page by 0.2 s

    return float(stdtrit(max(1.0, count - lost), (1 + level) / 2))


def mean_interval(scores: Scores, *, bounded: bool = False, floor: float = FLOOR) -> tuple[Array, Array]:
    """Return the ends of the 95 % interval of a mean, float64 (...) each; NaN where all clusters are equal.

    Args:
        scores: at least `FEWEST` clusters.
        bounded: whether the values are percentages, whose mean lies within 0 and 100.
        floor: `FLOOR`, or `INCREASE_FLOOR` for increases.
    """
    mean = scores.mean
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if bounded:
            share = mean / 100
            reach = _quantile(scores.clusters, 1) * scores.error / 100 / (share * (1 - share))
            odds = np.log(share / (1 - share))
            low, high = (100 / (1 + np.exp(-(odds + sign * reach))) for sign in (-1, 1))
        else:
            positive, negative = (_reaches(Scores(part, scores.den), floor) for part in parts(scores.num))
            low = mean - np.hypot(positive[0], negative[1])
            high = mean + np.hypot(positive[1], negative[0])
            mixed = (scores.num > 0).any(axis=-1) & (scores.num < 0).any(axis=-1)
            plain = np.where(mixed, _quantile(scores.clusters, 1) * scores.error, 0)
            low, high = np.minimum(low, mean - plain), np.maximum(high, mean + plain)
        varies = scores.error > _ROUNDING * np.abs(scores.num).sum(axis=-1)
    return np.where(varies, low, np.nan), np.where(varies, high, np.nan)


def parts(num: Array) -> tuple[Array, Array]:
    """Split scores into their positive and their negative part."""
    return np.maximum(num, 0), np.maximum(-num, 0)


def _reaches(scores: Scores, floor: float) -> tuple[Array, Array]:
    """Return how far the interval of a mean of values that are not negative reaches below and above the mean."""
    mean, count = scores.mean, scores.effective
    there = scores.den > 0
    share = scores.den[there]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = scores.num[..., there] / share
        logs = np.log(np.maximum(values, floor * mean[..., None]))
        off = logs - (share * logs).sum(axis=-1, keepdims=True)
        spread, upper = ((share * np.square(part)).sum(axis=-1) for part in (off, np.maximum(off, 0)))
        spread = (spread / 2 + upper) * count / (count - 1)
        variance = np.maximum(spread / count + np.square(spread) / (2 * (count - 1)), np.square(scores.error / mean))
        reach = _quantile(count, 2) * np.sqrt(variance)
        ends = -mean * np.expm1(-reach), mean * np.expm1(reach)
    return tuple(np.where(mean > 0, end, 0.0) for end in ends)  # type: ignore[return-value]


def ratio_interval(above: Scores, below: Scores) -> tuple[Array, Array]:
    """Return the ends of the 95 % interval of a ratio of means (CREr), of which the lower one is positive."""
    top, bottom = above.mean, below.mean
    (top_low, top_high), (low, high) = mean_interval(above), mean_interval(below)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = [part.num - part.mean[..., None] * part.den for part in (above, below)]
        product = (residual[0] * residual[1]).sum(axis=-1)
        correlation = (
            _CORRELATION * product / np.sqrt(np.prod([np.square(part).sum(axis=-1) for part in residual], axis=0))
        )
        ratio = top / bottom

        def joined(first: Array, second: Array) -> Array:
            return np.sqrt(np.maximum(first**2 + second**2 - 2 * correlation * first * second, 0))

        logs = (
            joined(np.log(top / top_low), np.log(high / bottom)),
            joined(np.log(top_high / top), np.log(bottom / low)),
        )
        plain = (
            joined((top - top_low) / bottom, ratio * (1 - bottom / high)),
            joined((top_high - top) / bottom, ratio * (bottom / low - 1)),
        )
        low_end = np.where(top_low > 0, ratio * np.exp(-logs[0]), ratio - plain[0])
        high_end = np.where(top_low > 0, ratio * np.exp(logs[1]), ratio + plain[1])
    return low_end, high_end


def flip_blocks(clusters: int, count: int = FLIPS) -> Iterator[Array]:
    """Yield the sign flips of a number of clusters in blocks, float64 (F, G), of which the first one changes nothing:
    one of each pair that differs only by the sign of all, or `count` random ones."""
    if clusters <= LISTED:
        bits = np.arange(2 ** max(0, clusters - 1))[:, None] >> np.arange(clusters) & 1
        yield (1 - 2 * bits).astype(np.float64)
        return
    stream, block = Rng.of(0, "flips", clusters), max(1, _BLOCK // clusters)
    yield np.ones((1, clusters))
    for start in range(0, count, block):
        size = min(block, count - start), clusters
        yield np.where(stream.uniforms(size[0] * clusters).reshape(size) < 0.5, -1.0, 1.0)


def flipped_sums(differences: Array, count: int = FLIPS) -> Array:
    """Return the size of the sum of each flip, float64 (..., F), rounded so that equal sums are equal."""
    scale = np.abs(differences).sum(axis=-1, keepdims=True)
    flips = flip_blocks(differences.shape[-1], count)
    sums = np.concatenate([np.abs(differences @ block.T) for block in flips], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(scale > 0, np.round(sums / scale, 10), 0.0))


def flip_test(differences: Array, count: int = FLIPS) -> Array:
    """Return the two-sided p-value of each row of differences of clusters, float64 (...)."""
    sums = flipped_sums(differences, count)
    return np.asarray((sums >= sums[..., :1]).mean(axis=-1))


def min_p(differences: Array) -> tuple[Array, Array]:
    """Return p-values of several hypotheses on the same clusters, and those adjusted for all of them.

    Args:
        differences: float64 (J, G), a row a hypothesis; 0 where a cluster has no value for it.
    """
    sums = flipped_sums(differences)
    ordered = np.sort(sums, axis=1)
    ranks = np.stack([np.searchsorted(line, sums[row], side="left") for row, line in enumerate(ordered)])
    every = 1 - ranks / sums.shape[1]  # the p-value that each flip would have had
    p = every[:, 0]
    adjusted, largest, smallest = np.ones(len(p)), 0.0, np.full(sums.shape[1], np.inf)
    steps = []
    for row in np.argsort(-p, kind="stable"):  # from the least to the most significant
        smallest = np.minimum(smallest, every[row])
        steps.append((row, float((smallest <= p[row] + 1e-15).mean())))
    for row, value in reversed(steps):
        adjusted[row] = largest = max(largest, value)
    return p, adjusted


def ratio_of_means(first: Array, second: Array) -> tuple[float, float] | None:
    """Return the ends of the 95 % interval of sum(first) / sum(second), which excludes 1 exactly if the flip test
    rejects at 5 %; None unless all values of the second are positive.

    Args:
        first, second: float64 (G,), what each cluster adds to the means of two models.
    """
    there = (second != 0) | (first != 0)
    if np.count_nonzero(there) < FEWEST or not (second[there] > 0).all():
        return None
    first, second = first[there], second[there]
    both = np.stack([first, second], axis=1)
    above, below = np.concatenate([(flips < 0) @ both for flips in flip_blocks(len(first))]).T
    of_both = np.array([above, first.sum() - above]), np.array([below, second.sum() - below])  # and the complements
    kept = of_both[1] > _ROUNDING * second.sum()
    ratios = np.sort(of_both[0][kept] / of_both[1][kept])
    cut = int(np.floor((1 - LEVEL) / 2 * (len(ratios) + 1)))  # the empty subset counts at both ends
    return (float(ratios[cut - 1]), float(ratios[-cut])) if cut else None
