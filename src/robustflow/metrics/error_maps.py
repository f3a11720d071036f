"""Compute end-point error maps (the Euclidean distance between two flow fields) and their sums.

All metrics follow the same pattern: a pure function computes *sums* over one image, a mean is sum / count, and averages
over images are computed later from the sums (`aggregate`). All arithmetic on the float32 flows is done in float64; sums
add the pixels sequentially in row-major order, so they are bit-identical on every machine and for every memory layout.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..compiled import njit_late, types
from ..errors import DataError
from ..sample import Flow, Mask, described_array

Errors = npt.NDArray[np.float64]
"""A map of errors or flow magnitudes, float64 (H, W), in pixels; NaN where undefined."""

# With read-only arrays in the signature, a single compiled version accepts writable and read-only arrays.
FLOW_TYPE = types.Array(types.float32, 3, "C", readonly=True)
ERRORS_TYPE = types.Array(types.float64, 2, "C", readonly=True)
MASK_TYPE = types.Array(types.boolean, 2, "C", readonly=True)


class ErrorSum(NamedTuple):
    """The sum of the errors of `n` pixels, in pixels."""

    n: int
    total: float

    @property
    def mean(self) -> float | None:
        """Return the sum divided by the count, or None if no pixel was counted."""
        return self.total / self.n if self.n else None


def epe_map(flow: Flow, reference: Flow) -> Errors:
    """Return |flow - reference| at every pixel."""
    a, b = flow_pair(flow, reference)
    with np.errstate(over="ignore", invalid="ignore"):
        return _lengths(np.subtract(a, b, dtype=np.float64))


def magnitude_map(flow: Flow) -> Errors:
    """Return |flow| at every pixel: float64 (H, W), in pixels; NaN where a component is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _lengths(flow_array(flow).astype(np.float64))


def error_sum(errors: Errors, mask: Mask | None = None) -> ErrorSum:
    """Return the count and the sum of the non-NaN errors inside `mask`, bool (H, W) (default: all pixels)."""
    inside = np.ones(errors.shape, np.bool_) if mask is None else mask
    n, total = _masked_sum(*dense(errors, inside))
    return ErrorSum(int(n), float(total))


def flow_array(flow: Flow) -> Flow:
    """Return `flow` as a C-contiguous array; raise a DataError if it is not a float32 array (H, W, 2)."""
    if not isinstance(flow, np.ndarray) or flow.dtype != np.float32 or flow.ndim != 3 or flow.shape[2] != 2:
        raise DataError(
            f"a flow must be a float32 array of shape (H, W, 2), not {described_array(flow)}; convert it first"
        )
    return np.require(flow, requirements=["C", "A"])


def flow_pair(flow: Flow, reference: Flow) -> tuple[Flow, Flow]:
    """Return two flows as C-contiguous arrays; raise a DataError if one of them is not a flow, or if their sizes
    differ.
    """
    a, b = flow_array(flow), flow_array(reference)
    if a.shape != b.shape:
        raise DataError(
            f"the flow is {a.shape[0]}x{a.shape[1]}, but its reference is {b.shape[0]}x{b.shape[1]}; "
            "both must have the size of the frames"
        )
    return a, b


def dense(*maps: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], ...]:
    """Return the maps as C-contiguous arrays; their sizes (H, W) must agree, because the compiled loops do not check
    bounds.
    """
    if any(each.shape[:2] != maps[0].shape[:2] for each in maps):
        raise DataError(f"the maps differ in size: {', '.join(str(each.shape[:2]) for each in maps)}")
    return tuple(np.require(each, requirements=["C", "A"]) for each in maps)


def _lengths(vectors: npt.NDArray[np.float64]) -> Errors:
    """Return the length of each vector, float64 (H, W); NaN where it is not finite."""
    u, v = vectors[..., 0], vectors[..., 1]
    square = u * u + v * v
    return np.sqrt(np.where(np.isfinite(square), square, np.nan))


@njit_late(types.Tuple((types.int64, types.float64))(ERRORS_TYPE, MASK_TYPE), cache=True)
def _masked_sum(errors: Any, mask: Any) -> Any:
    n, total = 0, 0.0
    for y in range(errors.shape[0]):
        for x in range(errors.shape[1]):
            if mask[y, x] and not math.isnan(errors[y, x]):
                n += 1
                total += errors[y, x]
    return n, total
