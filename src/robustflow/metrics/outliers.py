"""Compute outlier rates: Fl, the 1/3/5-px rates, and the weighted area under the inlier curve (WAUC).

- Fl (KITTI 2015 development kit): error > 3 px and error > 5 % of the ground-truth flow magnitude.
- n px: error > n px.
- WAUC (VIPER, Richter et al. 2017; computed as in the Spring benchmark): with thresholds t_i = i / 20 px, i = 1..100,
  and weights w_i = 1 - (i - 1) / 100,

      WAUC = sum_i w_i * share(error <= t_i) / sum_i w_i

  which is 1 for a perfect flow; the benchmarks report it in percent. If t_k is the smallest threshold that is not below
  a pixel's error, the pixel contributes sum_{i>=k} w_i / sum_i w_i = (101 - k)(102 - k) / 10100. These contributions
  are summed as integers.
"""

from __future__ import annotations

import math
from typing import Any

from ..compiled import njit

FL_PIXELS = 3.0
FL_SHARE = 0.05
WAUC_STEPS = 100
WAUC_PER_PIXEL = 20
"""Number of WAUC thresholds per pixel of error; the largest threshold is WAUC_STEPS / WAUC_PER_PIXEL = 5 px."""
WAUC_UNIT = WAUC_STEPS * (WAUC_STEPS + 1)
"""The WAUC of a pixel without error, in units of 1 / `WAUC_UNIT`."""


@njit(inline="always", cache=True)
def is_fl_outlier(error: Any, magnitude: Any) -> Any:
    """Return whether one pixel is an outlier by the Fl criterion; for use inside compiled loops."""
    return error > FL_PIXELS and error > FL_SHARE * magnitude


@njit(inline="always", cache=True)
def wauc_points(error: Any) -> Any:
    """Return the WAUC of one pixel, in units of 1 / `WAUC_UNIT`."""
    if error > WAUC_STEPS / WAUC_PER_PIXEL:
        return 0
    k = max(1, math.ceil(error * WAUC_PER_PIXEL))
    # For an error just above a threshold, the product may be rounded down to the threshold.
    if error > k / WAUC_PER_PIXEL:
        k += 1
    return (WAUC_STEPS + 1 - k) * (WAUC_STEPS + 2 - k)
