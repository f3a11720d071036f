"""Shares of pixels that are wrong: Fl, 1/3/5-px rates, and the weighted area under the inlier curve (WAUC).

- Fl (KITTI 2015 development kit): error > 3 px and error > 5 % of the ground truth's length.
- n px: error > n px.
- WAUC (VIPER, Richter et al. 2017; as the Spring benchmark computes it): with thresholds t_i = i / 20 px,
  i = 1..100, and weights w_i = 1 - (i - 1) / 100,

      WAUC = sum_i w_i * share(error <= t_i) / sum_i w_i

  of which the benchmarks print 100 times the value; 1 is a perfect flow. A pixel whose error first fits under
  threshold t_k adds sum_{i>=k} w_i / sum_i w_i = (101 - k)(102 - k) / 10100, summed here as integers.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit, types

from ..sample import Mask
from .epe import ERRORS_TYPE, MASK_TYPE, Errors, dense

FL_PIXELS = 3.0
FL_SHARE = 0.05
WAUC_STEPS = 100
WAUC_PER_PIXEL = 20
"""Thresholds per pixel of error: the largest is WAUC_STEPS / WAUC_PER_PIXEL = 5 px."""
_WAUC_UNIT = WAUC_STEPS * (WAUC_STEPS + 1)


class OutlierSums(NamedTuple):
    """Over `n` pixels: how many are outliers by each rule, and the sum of the pixels' WAUC (each from 0 to
    1)."""

    n: int
    fl_count: int
    px1_count: int
    px3_count: int
    px5_count: int
    wauc_sum: float


def outlier_sums(errors: Errors, magnitude: Errors, mask: Mask) -> OutlierSums:
    """Outliers among the pixels inside `mask` whose error is not NaN.

    Args:
        errors: float64 (H, W), end-point errors in pixels.
        magnitude: float64 (H, W), length of the ground truth in pixels.
        mask: bool (H, W).

    >>> import numpy as np
    >>> sums = outlier_sums(np.array([[0.0, 4.0]]), np.array([[1.0, 200.0]]), np.ones((1, 2), bool))
    >>> sums.px3_count, sums.fl_count, round(sums.wauc_sum, 4)
    (1, 0, 1.0457)
    """
    n, fl, px1, px3, px5, points = (int(count) for count in _outliers(*dense(errors, magnitude, mask)))
    return OutlierSums(n, fl, px1, px3, px5, points / _WAUC_UNIT)


@njit(types.boolean(types.float64, types.float64), inline="always", cache=True)
def is_fl_outlier(error: Any, magnitude: Any) -> Any:
    """The rule of Fl for one pixel; for use inside compiled loops."""
    return error > FL_PIXELS and error > FL_SHARE * magnitude


@njit(types.int64(types.float64), inline="always", cache=True)
def _wauc_points(error: Any) -> Any:
    """The pixel's WAUC in units of 1 / 10100."""
    if error > WAUC_STEPS / WAUC_PER_PIXEL:
        return 0
    k = max(1, math.ceil(error * WAUC_PER_PIXEL))
    # The product may round down onto the threshold of an error just above it.
    if error > k / WAUC_PER_PIXEL:
        k += 1
    return (WAUC_STEPS + 1 - k) * (WAUC_STEPS + 2 - k)


@njit(types.UniTuple(types.int64, 6)(ERRORS_TYPE, ERRORS_TYPE, MASK_TYPE), cache=True)
def _outliers(errors: Any, magnitude: Any, mask: Any) -> Any:
    n, fl, px1, px3, px5, points = 0, 0, 0, 0, 0, 0
    for y in range(errors.shape[0]):
        for x in range(errors.shape[1]):
            error = errors[y, x]
            if not mask[y, x] or math.isnan(error):
                continue
            n += 1
            fl += is_fl_outlier(error, magnitude[y, x])
            px1 += error > 1.0
            px3 += error > 3.0
            px5 += error > 5.0
            points += _wauc_points(error)
    return n, fl, px1, px3, px5, points
