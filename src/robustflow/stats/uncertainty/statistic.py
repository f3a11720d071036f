"""Statistics of the clusters in many resamples: means over images, their differences and ratios, and standard errors.

A cluster is a video sequence, or a single image if images are independent; its images are always drawn together. Let
T_gk be the sum over the images of cluster g at condition k (a corruption at a severity), N_gk the number of these
images, w_g the number of times that the cluster was drawn, and v_k the weight of condition k (with sum 1). Then

    mean_k = sum_g w_g T_gk / sum_g w_g N_gk        theta = sum_k v_k mean_k

is the paper's average, and to first order the influence of cluster g on it is

    U_g = sum_k v_k (T_gk - mean_k N_gk) / sum_h w_h N_hk .

The w_g U_g add up to zero, and G / (G - 1) sum_g w_g U_g^2 estimates the variance of theta (the sandwich of a
clustered mean, with its small-sample factor). Differences and ratios of these means follow by the chain rule, so the
same code handles EPE, CRE, CREr and RCRE, for one model or the difference between two.

`weighted_means` computes this formula. `Statistic` avoids its arrays of size resamples x clusters by multiplying the
weights by a few columns. A statistic is a sum of terms +-A or +-A/C, where A and C are such weighted means. Conditions
with the same number of images in every cluster (in a complete run, all conditions) share one column. With x_g =
sum_k v_k T_gk over such conditions and N_g the number of their images,

    m = sum_g w_g x_g / sum_g w_g N_g        A = sum of the m of its columns

and, with f_j the derivative of the statistic with respect to column j, the influence of cluster g is

    U_g = sum_j f_j (x_gj - m_j N_gj) / n_j         n_j = sum_g w_g N_gj

so sum_g w_g U_g^2 is a quadratic form in the columns (x, N), whose coefficients are weights times products of columns.
Columns are centred by the means of the data to avoid cancellation. Resamples without any image in some column, and
statistics with more than `_COLUMNS` columns, are computed from `Estimates` instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_COLUMNS = 12
_ROUNDING = 1e-13

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimates:
    """The values of one statistic in B resamples."""

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
    """Compute the weighted mean over conditions of the means over images."""
    sums, images = weights @ total, weights @ count
    present = (images > 0) * share
    with np.errstate(divide="ignore", invalid="ignore"):
        present = present / present.sum(axis=1, keepdims=True)
        per_image = np.where(images > 0, present / images, 0.0)
        means = np.where(images > 0, sums / images, 0.0)
    theta = np.where(images.any(axis=1), (present * means).sum(axis=1), np.nan)
    return Estimates(theta, per_image @ total.T - (per_image * means) @ count.T, weights)


class StatisticValues(NamedTuple):
    """The values of a statistic and its standard error in B resamples, float64 (B,) each."""

    theta: Array
    standard_error: Array


@dataclass(frozen=True, eq=False)
class Mean:
    """The weighted mean over conditions of the means over images."""

    total: Array
    count: Array
    share: Array

    def columns(self) -> tuple[Array, Array]:
        """Return x and N, float64 (G, J), where conditions with the same image counts share a column."""
        column_of: dict[bytes, int] = {}
        places = [column_of.setdefault(column.tobytes(), len(column_of)) for column in self.count.T]
        placed = np.zeros((len(places), len(column_of)))
        placed[np.arange(len(places)), places] = self.share
        return self.total @ placed, self.count[:, [places.index(place) for place in range(len(column_of))]]

    def estimates(self, weights: Array) -> Estimates:
        """Compute the estimates and the influence of each cluster for the given weights, float64 (B, G)."""
        return weighted_means(self.total, self.count, self.share, weights)


@dataclass(frozen=True, eq=False)
class Term:
    """`sign` times a mean or a ratio of two means."""

    mean: Mean
    over: Mean | None = None
    sign: float = 1.0


class Statistic:
    """A sum of terms. Calling the statistic with weights, float64 (B, G), returns its values in every resample."""

    def __init__(self, terms: Sequence[Term]) -> None:
        self.terms = tuple(terms)
        means = [mean for term in self.terms for mean in (term.mean, term.over) if mean is not None]
        self.clusters = int(np.all([mean.count.any(axis=1) for mean in means], axis=0).sum())
        parts = [mean.columns() for mean in means]
        edges = np.cumsum([0, *(x.shape[1] for x, _ in parts)])
        self._slices = [slice(start, end) for start, end in pairwise(edges)]
        images = np.concatenate([images for _, images in parts], axis=1)
        sums = np.concatenate([x for x, _ in parts], axis=1)
        self._count = sums.shape[1] if sums.shape[1] <= _COLUMNS else 0
        with np.errstate(divide="ignore", invalid="ignore"):
            self._centers = np.nan_to_num(sums.sum(axis=0) / images.sum(axis=0))
        both = np.concatenate([sums - self._centers * images, images], axis=1)[:, : 2 * self._count]
        self._first, self._second = np.triu_indices(2 * self._count)
        self.columns = np.concatenate([both, both[:, self._first] * both[:, self._second]], axis=1)

    def __sub__(self, other: Statistic) -> Statistic:
        return Statistic([*self.terms, *(Term(term.mean, term.over, -term.sign) for term in other.terms)])

    def __call__(self, weights: Array) -> StatisticValues:
        return self.values(weights, weights @ self.columns)

    def values(self, weights: Array, products: Array) -> StatisticValues:
        """Compute the values from the weights, float64 (B, G), and their products with `columns`, float64 (B, P)."""
        count = self._count
        images = products[:, count : 2 * count]
        if not count or not (images > 0).all():
            estimates = self.estimates(weights)
            return StatisticValues(estimates.theta, estimates.standard_error)
        means = products[:, :count] / images  # relative to the centres
        slopes = np.zeros_like(means)
        theta = np.zeros(len(weights))
        at = iter(self._slices)
        with np.errstate(divide="ignore", invalid="ignore"):
            for term in self.terms:
                columns = next(at)
                mean = means[:, columns].sum(axis=1) + self._centers[columns].sum()
                if term.over is None:
                    theta += term.sign * mean
                    slopes[:, columns] = term.sign
                    continue
                below = next(at)
                divisor = means[:, below].sum(axis=1) + self._centers[below].sum()
                theta += term.sign * mean / divisor
                slopes[:, columns] = (term.sign / divisor)[:, None]
                slopes[:, below] = (-term.sign * mean / divisor**2)[:, None]
            slopes /= images
            coefficients = np.concatenate([slopes, -slopes * means], axis=1)
            form = coefficients[:, self._first] * coefficients[:, self._second]
            parts = form * products[:, 2 * count :] * np.where(self._first == self._second, 1.0, 2.0)
            squares = parts.sum(axis=1)
            squares[squares <= _ROUNDING * np.abs(parts).sum(axis=1)] = 0.0  # a single cluster has no spread
        clusters = weights.shape[1]
        if clusters < 2:
            return StatisticValues(theta, np.full(len(theta), np.nan))
        return StatisticValues(theta, np.sqrt(clusters / (clusters - 1) * squares))

    def estimates(self, weights: Array) -> Estimates:
        """Compute `values` together with the influence of every cluster, float64 (B, G), which is slower by a factor of
        about the number of clusters."""
        total: Estimates | None = None
        for term in self.terms:
            one = term.mean.estimates(weights)
            one = one / term.over.estimates(weights) if term.over is not None else one
            one = Estimates(term.sign * one.theta, term.sign * one.influence, weights)
            total = one if total is None else total + one
        assert total is not None
        return total
