"""Statistics of the clusters in many resamples: means over images, their differences and ratios, and standard errors.

A cluster is a video sequence, or a single image if images are independent; its images are always drawn together. Let
T_gk be the sum over the images of cluster g at condition k (a corruption at a severity), N_gk the number of these
images, w_g the number of times that the cluster was drawn, and v_k the weight of condition k (with sum 1). Then

    mean_k = sum_g w_g T_gk / sum_g w_g N_gk        theta = sum_k v_k mean_k

is the paper's average, and to first order the influence of cluster g on it is

    U_g = sum_k v_k (T_gk - mean_k N_gk) / sum_h w_h N_hk .

The w_g U_g add up to zero, and G / (G - 1) sum_g w_g U_g^2 estimates the variance of theta (the sandwich of a
clustered mean, with its small-sample factor). Differences, ratios and logarithms of these means follow by the chain
rule, so a statistic is any function of the weights that computes with `Estimates`, for one model or for two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .inference import Scores

_ROUNDING = 1e-12

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimates:
    """The values of a statistic in B resamples of G clusters, and its derivatives with respect to the sums that it is
    computed from.

    Attributes:
        theta: values, float64 (B,).
        slopes: derivatives with respect to each sum, float64 (B, J).
        columns: the terms of the sums, float64 (G, J): a sum is their mean weighted with the weights.
        weights: how often each cluster was drawn, float64 (B, G).
        seen: the clusters with images for every mean, bool (G,).
    """

    theta: Array
    slopes: Array
    columns: Array
    weights: Array
    seen: npt.NDArray[np.bool_]

    def __sub__(self, other: Estimates) -> Estimates:
        with np.errstate(invalid="ignore"):
            return self._joined(other, self.theta - other.theta, self.slopes, -other.slopes)

    def __truediv__(self, other: Estimates) -> Estimates:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio, below = self.theta / other.theta, other.theta[:, None]
            return self._joined(other, ratio, self.slopes / below, -ratio[:, None] * other.slopes / below)

    def _joined(self, other: Estimates, theta: Array, *slopes: Array) -> Estimates:
        columns = np.concatenate([self.columns, other.columns], axis=1)
        return Estimates(theta, np.concatenate(slopes, axis=1), columns, self.weights, self.seen & other.seen)

    def log(self, plus: float = 0.0) -> Estimates:
        """Return the logarithm, after adding a constant."""
        with np.errstate(divide="ignore", invalid="ignore"):
            size = self.theta + plus
            return replace(self, theta=np.log(size), slopes=self.slopes / size[:, None])

    @property
    def value(self) -> float:
        """The value in the first resample."""
        return float(self.theta[0])

    @property
    def error(self) -> float:
        """The standard error in the first resample."""
        return float(self.standard_error[0])

    @property
    def clusters(self) -> int:
        """The number of clusters with images for every mean."""
        return int(self.seen.sum())

    @property
    def influence(self) -> Array:
        """float64 (B, G), the derivative with respect to the weight of each cluster."""
        with np.errstate(invalid="ignore"):
            return self.slopes @ self.columns.T

    @property
    def standard_error(self) -> Array:
        """float64 (B,), standard error of the statistic in each resample by the sandwich formula; NaN for one cluster,
        and 0 if it is only rounding error, as in a resample of a single cluster."""
        clusters = self.weights.shape[1]
        if clusters < 2:
            return np.full(len(self.theta), np.nan)
        influence = self.influence
        squares = np.einsum("bg,bg,bg->b", self.weights, influence, influence)
        error = np.sqrt(clusters / (clusters - 1) * squares)
        return np.where(error <= _ROUNDING * np.abs(self.theta), 0.0, error)


Statistic = Callable[[Array], Estimates]
"""A statistic as a function of the weights of the clusters, float64 (B, G)."""


def of_data(statistic: Statistic, clusters: int) -> Estimates:
    """Compute a statistic of the data themselves, in which each cluster occurs once."""
    return statistic(np.ones((1, clusters)))


def difference(first: Statistic, second: Statistic) -> Statistic:
    """Return a difference of statistics."""
    return lambda weights: first(weights) - second(weights)


class Mean:
    """The weighted mean over conditions of the means over images. Where no image of some conditions was drawn, the mean
    is over the others.

    Args:
        total, count: sums over the images of each cluster at each condition, and numbers of images, float64 (G, K).
        share: weights of the conditions, float64 (K,).
    """

    def __init__(self, total: Array, count: Array, share: Array) -> None:
        self.total, self.count = total @ share, count @ share
        # Conditions with the same images, in a complete run all of them, are computed as one.
        columns: dict[bytes, list[int]] = {}
        for condition, images in enumerate(count.T):
            columns.setdefault(images.tobytes(), []).append(condition)
        alike = list(columns.values())
        counts = count[:, [conditions[0] for conditions in alike]]
        totals = np.array([total[:, some] @ share[some] for some in alike]).reshape(len(alike), len(total)).T
        self._columns = np.concatenate([totals, counts], axis=1)
        self._shares = np.array([share[some].sum() for some in alike])
        self._seen = counts.sum(axis=1) > 0

    @property
    def scores(self) -> Scores:
        """What each cluster adds to the mean, and its share of the images."""
        totals, counts = np.split(self._columns, 2, axis=1)
        images = counts.sum(axis=0)
        return Scores((totals / images).sum(axis=1), counts / images @ self._shares)

    def __call__(self, weights: Array) -> Estimates:
        """Compute the mean in each resample."""
        sums, images = np.split(weights @ self._columns, 2, axis=1)
        drawn = images > 0
        known = (drawn @ self._shares)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            per_image = np.where(drawn, 1 / (images * known), 0.0)
            means = np.where(drawn, sums / images, 0.0)
            theta = np.where(drawn.any(axis=1), (means / known).sum(axis=1), np.nan)
        slopes = np.concatenate([per_image, -per_image * means], axis=1)
        return Estimates(theta, slopes, self._columns, weights, self._seen)


@dataclass(frozen=True, eq=False)
class ErrorMean:
    """A mean error, or the mean increase of an error over another, which may be relative to it."""

    mean: Mean
    over: Mean | None = None
    relative: bool = False

    def __call__(self, weights: Array) -> Estimates:
        """Compute the mean in each resample."""
        mean = self.mean(weights)
        return mean / self.over(weights) if self.over is not None and self.relative else mean

    def logarithms(self) -> dict[str, Statistic]:
        """Return the logarithms that determine the mean: of "size", and of "growth" plus 1."""
        mean, over = self.mean, self.over
        if over is None:
            return {"size": lambda weights: mean(weights).log()}
        growth: dict[str, Statistic] = {"growth": lambda weights: (mean(weights) / over(weights)).log(plus=1)}
        return growth if self.relative else {"size": lambda weights: over(weights).log(), **growth}
