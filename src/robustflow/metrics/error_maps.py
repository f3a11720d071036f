"""Compute outlier rates: Fl, the 1/3/5-px rates, and the weighted area under the inlier curve (WAUC). Compute the
paper's robustness metrics CRE, CREr and RCRE (section "Robustness Metrics"). Compute end-point error maps (the
Euclidean distance between two flow fields) and their sums.

- Fl (KITTI 2015 development kit): error > 3 px and error > 5 % of the ground-truth flow magnitude.
- n px: error > n px.
- WAUC (VIPER, Richter et al. 2017; computed as in the Spring benchmark): with thresholds t_i = i / 20 px, i = 1..100,
  and weights w_i = 1 - (i - 1) / 100,

      WAUC = sum_i w_i * share(error <= t_i) / sum_i w_i

  which is 1 for a perfect flow; the benchmarks report it in percent. If t_k is the smallest threshold that is not below
  a pixel's error, the pixel contributes sum_{i>=k} w_i / sum_i w_i = (101 - k)(102 - k) / 10100. These contributions
  are summed as integers.

CRE and CREr are computed from the mean errors over an image, a corruption or the complete run:

    CRE_{c,s} = EPE_{c,s} - EPE_clean            absolute robustness, pixels
    CREr      = CRE / EPE_clean                  relative robustness, dimensionless
    RCRE_{c,s} = |f_{c,s} - f_clean|             needs no ground truth, pixels (`of_arrays.rcre`)

CRE is negative if a corruption reduces the error, and RCRE >= |CRE| over the same pixels.

All metrics follow the same pattern: a pure function computes *sums* over one image, a mean is sum / count, and averages
over images are computed later from the sums (`means`). All arithmetic on the float32 flows is done in float64; sums
add the pixels sequentially in row-major order, so they are bit-identical on every machine and for every memory layout.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit
from ..core.errors import DataError
from ..core.types import Flow, Mask, described_array

FL_PIXELS = 3.0
FL_SHARE = 0.05
LEAST_CLEAN = 1 / 64
"""The step in which KITTI stores ground truth, in pixels: nothing is divided by a smaller clean error."""
LARGEST_ERROR = 2.0**27
"""Mean error of an image in pixels above which differences are not known to a hundredth of a pixel: its sum over half a
million pixels is rounded by up to 2^-53 of itself at each addition."""
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
    k = np.maximum(1, math.ceil(error * WAUC_PER_PIXEL))
    # For an error just above a threshold, the product may be rounded down to the threshold.
    if error > k / WAUC_PER_PIXEL:
        k += 1
    return (WAUC_STEPS + 1 - k) * (WAUC_STEPS + 2 - k)


def cre(epe: float | None, epe_clean: float | None) -> float | None:
    """Return the Corruption Robustness Error, i.e. the increase in error, in pixels; None if either error is None or
    above `LARGEST_ERROR`."""
    return None if epe is None or epe_clean is None or max(epe, epe_clean) > LARGEST_ERROR else epe - epe_clean


def crer(cre: float | None, epe_clean: float | None) -> float | None:
    """Return the Corruption Robustness Error ratio; None if the CRE is None or the clean error is None or below
    `LEAST_CLEAN`."""
    return None if cre is None or epe_clean is None or epe_clean < LEAST_CLEAN else cre / epe_clean


Errors = npt.NDArray[np.float64]
"""A map of errors or flow magnitudes, float64 (H, W), in pixels; NaN where undefined."""

# With read-only arrays in the signature, a single compiled version accepts writable and read-only arrays.
FLOW_TYPE = "Array(float32, 3, 'C', readonly=True)"
ERRORS_TYPE = "Array(float64, 2, 'C', readonly=True)"
MASK_TYPE = "Array(boolean, 2, 'C', readonly=True)"


def epe_map(flow: Flow, reference: Flow) -> Errors:
    """Return |flow - reference| at every pixel."""
    a, b = flow_pair(flow, reference)
    with np.errstate(over="ignore", invalid="ignore"):
        return _lengths(np.subtract(a, b, dtype=np.float64))


def magnitude_map(flow: Flow) -> Errors:
    """Return |flow| at every pixel: float64 (H, W), in pixels; NaN where a component is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _lengths(flow_array(flow).astype(np.float64))


def error_sum(errors: Errors, mask: Mask | None = None) -> tuple[int, float]:
    """Return the number and the sum of the errors inside `mask`, bool (H, W) (default: all pixels), that are not NaN,
    added in row-major order."""
    known = ~np.isnan(errors)
    inside = errors[known if mask is None else known & mask]
    return inside.size, float(np.cumsum(inside)[-1]) if inside.size else 0.0


def flow_array(flow: Flow) -> Flow:
    """Return `flow` as a C-contiguous array; raise a DataError if it is not a float32 array (H, W, 2)."""
    if not isinstance(flow, np.ndarray) or flow.dtype != np.float32 or flow.ndim != 3 or flow.shape[2] != 2:
        raise DataError(
            "flow", f"it must be a float32 array of shape (H, W, 2), not {described_array(flow)}; convert it first"
        )
    return np.require(flow, requirements=["C", "A"])


def flow_pair(flow: Flow, reference: Flow) -> tuple[Flow, Flow]:
    """Return two flows as C-contiguous arrays; raise a DataError if one of them is not a flow, or if their sizes
    differ.
    """
    a, b = flow_array(flow), flow_array(reference)
    if a.shape != b.shape:
        raise DataError(
            "flow",
            f"it is {a.shape[0]}x{a.shape[1]}, but its reference is {b.shape[0]}x{b.shape[1]}; both must have the size "
            "of the frames",
        )
    return a, b


def dense(*maps: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], ...]:
    """Return the maps as C-contiguous arrays; their sizes (H, W) must agree, because the compiled loops do not check
    bounds.
    """
    if any(array.shape[:2] != maps[0].shape[:2] for array in maps):
        raise DataError("maps", f"they differ in size: {', '.join(str(array.shape[:2]) for array in maps)}")
    return tuple(np.require(array, requirements=["C", "A"]) for array in maps)


def _lengths(vectors: npt.NDArray[np.float64]) -> Errors:
    """Return the length of each vector, float64 (H, W); NaN where it is not finite."""
    u, v = vectors[..., 0], vectors[..., 1]
    square = u * u + v * v
    return np.sqrt(np.where(np.isfinite(square), square, np.nan))
