"""Functions shared by all flow formats: detection of unknown values, and checks of arrays to write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..sample import Flow, Mask

MAX_SIDE = 99_999
"""Maximum width and height in any format; the limit of Middlebury's own reader."""

MAX_PIXELS = 2**26
"""Maximum number of pixels, 67 million; larger files are rejected before decompression. Spring, the dataset with the
largest flow, has 8 million."""

UNKNOWN_THRESHOLD = 1e9
"""Threshold beyond which a component marks unknown flow, as in Middlebury's format."""


def known(values: npt.NDArray[Any]) -> tuple[Flow, Mask]:
    """Split raw components (H, W, 2) into float32 flow and bool valid.

    A pixel is unknown when a component is NaN, infinite, or beyond 1e9 in magnitude; its flow is then 0.
    """
    flow = np.array(values, np.float32, order="C")
    valid = np.asarray((np.abs(flow) <= UNKNOWN_THRESHOLD).all(axis=2))
    flow[~valid] = 0
    return flow, valid


def checked(path: Path, flow: npt.ArrayLike, valid: npt.ArrayLike | None) -> tuple[Flow, Mask]:
    """Return the arrays to write, float32 (H, W, 2) and bool (H, W), with non-finite pixels marked as unknown.

    Raises:
        DataError: a shape or dtype is wrong, there are no pixels, or a known component is beyond 1e9, which would be
            read as unknown.
    """
    array = np.asarray(flow)
    if array.ndim != 3 or array.shape[2] != 2 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise DataError(f"{path}: cannot write {array.dtype} {array.shape} as flow; give numbers of shape (H, W, 2)")
    if max(array.shape[:2]) > MAX_SIDE:
        raise DataError(f"{path}: a flow of {array.shape[1]}x{array.shape[0]} exceeds {MAX_SIDE} pixels a side")
    mask = np.ones(array.shape[:2], bool) if valid is None else np.asarray(valid)
    if mask.shape != array.shape[:2] or mask.dtype != np.bool_:
        raise DataError(f"{path}: valid is {mask.dtype} {mask.shape}; give bool {array.shape[:2]}, as the flow")
    mask = mask & np.isfinite(array).all(axis=2)
    if (np.abs(array[mask]) > UNKNOWN_THRESHOLD).any():
        raise DataError(f"{path}: a known component beyond 1e9 would read as unknown; mark such pixels invalid")
    return np.where(mask[..., None], array, 0).astype(np.float32), mask


def claimed_size(path: Path, width: int, height: int) -> None:
    """Reject implausible dimensions before memory is allocated."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise DataError(f"{path}: the header claims {width}x{height} pixels, so the file is damaged; download it again")
    if width * height > MAX_PIXELS:
        raise DataError(f"{path}: {width}x{height} pixels are more than the {MAX_PIXELS} of a flow; cut it into parts")


def exact_size(path: Path, expected: int, size: int, width: int, height: int) -> None:
    """Reject a file whose length does not match its header."""
    if size != expected:
        state = "cut short" if size < expected else "too long"
        raise DataError(f"{path}: {state}, {size} bytes where {width}x{height} pixels take {expected}; copy it again")
