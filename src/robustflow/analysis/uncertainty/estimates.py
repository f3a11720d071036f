"""Means over images and the contribution of each cluster, vectorised over resamples.

A cluster is a video sequence, or a single image if images are independent; its images are always drawn together. Let
T_gk be the sum over the images of cluster g at condition k (a corruption at a severity), N_gk the number of these
images, w_g the number of times that the cluster was drawn, and v_k the weight of condition k (with sum 1). Then

    mean_k = sum_g w_g T_gk / sum_g w_g N_gk        theta = sum_k v_k mean_k

is the paper's average, and to first order the influence of cluster g on it is

    U_g = sum_k v_k (T_gk - mean_k N_gk) / sum_h w_h N_hk .

The w_g U_g add up to zero, and G / (G - 1) sum_g w_g U_g^2 estimates the variance of theta (the sandwich of a
clustered mean, with its small-sample factor). Differences and ratios of these means follow by the chain rule, so the
same code handles EPE, CRE, CREr and RCRE, for one model or the difference between two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimates:
    """The values of one statistic in B resamples.

    Attributes:
        theta: float64 (B,), value of the statistic; NaN where a resample contains no image.
        influence: float64 (B, G), first-order contribution of each cluster to `theta`.
        weights: float64 (B, G), number of times that each cluster was drawn.
    """

    theta: Array
    influence: Array
    weights: Array

    def __add__(self, other: Estimates) -> Estimates:
        return Estimates(self.theta + other.theta, self.influence + other.influence, self.weights)

    def __truediv__(self, other: Estimates) -> Estimates:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.theta / other.theta
            influence = (self.influence - ratio[:, None] * other.influence) / other.theta[:, None]
        return Estimates(ratio, influence, self.weights)

    @property
    def standard_error(self) -> Array:
        """float64 (B,), standard error of the statistic in each resample by the sandwich formula; NaN for one
        cluster."""
        clusters = self.weights.shape[1]
        if clusters < 2:
            return np.full(len(self.theta), np.nan)
        squares = np.einsum("bg,bg,bg->b", self.weights, self.influence, self.influence)
        return np.asarray(np.sqrt(clusters / (clusters - 1) * squares))


def weighted_means(total: Array, count: Array, share: Array, weights: Array) -> Estimates:
    """Compute the weighted mean over conditions of the means over images.

    Args:
        total: float64 (G, K), sums over the images of a cluster at a condition, 0 where the cluster has no images.
        count: float64 (G, K), number of these images.
        share: float64 (K,), weight of each condition; if a resample has no image at a condition, its weight is
            distributed over the other conditions.
        weights: float64 (B, G), number of times that each cluster is drawn in each resample.

    >>> import numpy as np
    >>> total, once = np.array([[1.0], [2.0], [3.0], [6.0]]), np.ones((1, 4))
    >>> mean = weighted_means(total, np.ones((4, 1)), np.ones(1), once)
    >>> mean.theta.tolist(), mean.standard_error.round(4).tolist()
    ([3.0], [1.0801])
    """
    sums, images = weights @ total, weights @ count
    present = (images > 0) * share
    with np.errstate(divide="ignore", invalid="ignore"):
        present = present / present.sum(axis=1, keepdims=True)
        per_image = np.where(images > 0, present / images, 0.0)
        means = np.where(images > 0, sums / images, 0.0)
    theta = np.where(images.any(axis=1), (present * means).sum(axis=1), np.nan)
    return Estimates(theta, per_image @ total.T - (per_image * means) @ count.T, weights)
