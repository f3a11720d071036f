"""Scale, flip and crop a training pair: draw the parameters, and apply them to frames and to dense or sparse ground
truth."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from ...core.compiled import njit
from ...core.rng import Rng
from ...core.types import Flow, Frame, Mask

_SCALED = 0.8
"""Probability of scaling."""
_STRETCHED = 0.8
_STRETCH = 0.2
"""Maximum stretch of one axis, as a power of two."""
_FLIPPED = (0.5, 0.1)
"""Probabilities of horizontal and vertical flips."""
_MARGIN = {"dense": 8, "sparse": 1}
"""Minimum difference between the size of a scaled frame and the crop, in pixels."""
_OVERHANG = (20, 50)
"""Number of rows and columns by which the crop of a sparse pair may extend beyond the frame when it is drawn. It is
then moved back inside, so that crops include the borders more often."""


class Geometry(NamedTuple):
    """One set of drawn parameters."""

    scale: tuple[float, float] | None
    mirrored: bool
    upside_down: bool
    top: int
    left: int


def draw_geometry(
    rng: Rng,
    shape: tuple[int, int],
    crop: tuple[int, int],
    log2_scale: tuple[float, float],
    flip: bool,
    sparse: bool,
) -> Geometry:
    """Draw the geometry as in RAFT, for dense or sparse ground truth."""
    height, width = shape
    margin = _MARGIN["sparse" if sparse else "dense"]
    least = max((crop[0] + margin) / height, (crop[1] + margin) / width)
    x = y = 2.0 ** rng.uniform(*log2_scale)
    if not sparse and rng.uniform() < _STRETCHED:
        x *= 2.0 ** rng.uniform(-_STRETCH, _STRETCH)
        y *= 2.0 ** rng.uniform(-_STRETCH, _STRETCH)
    scale = None
    if rng.uniform() < _SCALED or height < crop[0] or width < crop[1]:
        scale = (max(x, least), max(y, least))
        width, height = scaled_size(shape, scale)
    mirrored = flip and rng.uniform() < _FLIPPED[0]
    upside_down = flip and not sparse and rng.uniform() < _FLIPPED[1]
    free = (height - crop[0], width - crop[1])
    if sparse:
        rows = rng.integer(0, free[0] + _OVERHANG[0])
        columns = rng.integer(-_OVERHANG[1], free[1] + _OVERHANG[1])
        top, left = min(max(rows, 0), free[0]), min(max(columns, 0), free[1])
    else:
        top, left = (rng.integer(0, max(rows_or_columns, 1)) for rows_or_columns in free)
    return Geometry(scale, mirrored, upside_down, top, left)


def padding_for(shape: tuple[int, int], crop: tuple[int, int]) -> tuple[int, int]:
    """Return the number of rows and columns that `shape` (H, W) lacks compared with `crop` (H, W)."""
    return max(crop[0] - shape[0], 0), max(crop[1] - shape[1], 0)


def padded(array: Any, padding: tuple[int, int]) -> Any:
    """Add rows of zeros at the bottom and columns of zeros on the right of a frame, flow or mask (H, W, ...)."""
    if not any(padding):
        return array
    return np.pad(array, ((0, padding[0]), (0, padding[1]), (0, 0))[: array.ndim])


def scaled_size(shape: tuple[int, int], scale: tuple[float, float]) -> tuple[int, int]:
    """Return the size (W, H) of frames of `shape` (H, W) after scaling by (x, y), rounded half to even as in OpenCV and
    Python."""
    return round(shape[1] * scale[0]), round(shape[0] * scale[1])


def warp_frame(frame: Frame, geometry: Geometry, crop: tuple[int, int]) -> Frame:
    """Scale (bilinear, half-pixel centres), flip and crop a frame; return a new array, RGB uint8 (*crop, 3)."""
    if geometry.scale is not None:
        x, y = geometry.scale
        frame = cv2.resize(frame, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(_cropped(frame, geometry, crop))


def without_border(frame: Frame, border: int) -> Frame:
    """Remove `border` pixels on each side of a frame and enlarge it to its original size, scaling as in `warp_frame`;
    return a new array.

    >>> without_border(np.arange(8, dtype=np.uint8).repeat(24).reshape(8, 8, 3), 2)[:, 0, 0].tolist()
    [2, 2, 3, 3, 4, 4, 5, 5]
    """
    height, width = frame.shape[:2]
    inner = frame[border : height - border, border : width - border]
    return cv2.resize(inner, (width, height), interpolation=cv2.INTER_LINEAR)


def warp_dense(flow: Flow, valid: Mask, geometry: Geometry, crop: tuple[int, int]) -> tuple[Flow, Mask]:
    """Warp dense flow, scaling and flipping its vectors with the frames. A pixel is valid if all four pixels from which
    it is interpolated are valid."""
    if geometry.scale is not None:
        x, y = geometry.scale
        flow = cv2.resize(flow, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
        flow = flow * np.array([x, y], np.float32)
        if not valid.all():
            share = cv2.resize(valid.astype(np.float32), None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
            valid = np.asarray(share > 0.999)
        else:
            valid = np.ones(flow.shape[:2], bool)
    return _turned(_cropped(flow, geometry, crop), geometry), np.ascontiguousarray(_cropped(valid, geometry, crop))


def warp_sparse(flow: Flow, valid: Mask, geometry: Geometry, crop: tuple[int, int]) -> tuple[Flow, Mask]:
    """Warp sparse flow: each valid point moves to the pixel nearest to its new position. Points in the first row or
    column, or outside the frame, are lost, as in the original."""
    if geometry.scale is not None:
        width, height = scaled_size(flow.shape[:2], geometry.scale)
        flow, valid = _resized_sparse_flow(np.ascontiguousarray(flow), valid, *geometry.scale, height, width)
    return _turned(_cropped(flow, geometry, crop), geometry), np.ascontiguousarray(_cropped(valid, geometry, crop))


def _cropped(array: Any, geometry: Geometry, crop: tuple[int, int]) -> Any:
    """Return a flipped and cropped view."""
    if geometry.mirrored:
        array = array[:, ::-1]
    if geometry.upside_down:
        array = array[::-1]
    return array[geometry.top : geometry.top + crop[0], geometry.left : geometry.left + crop[1]]


def _turned(flow: Flow, geometry: Geometry) -> Flow:
    """Flip the signs of vectors in flipped frames; return a new array."""
    signs = [-1 if geometry.mirrored else 1, -1 if geometry.upside_down else 1]
    return np.ascontiguousarray(flow * np.array(signs, np.float32))


@njit(cache=True, nogil=True)
def _resized_sparse_flow(flow: Any, valid: Any, x: Any, y: Any, height: Any, width: Any) -> Any:
    moved = np.zeros((height, width, 2), np.float32)
    known = np.zeros((height, width), np.bool_)
    for row in range(flow.shape[0]):
        new_row = int(np.rint(row * y))
        if new_row <= 0 or new_row >= height:
            continue
        for column in range(flow.shape[1]):
            new_column = int(np.rint(column * x))
            if valid[row, column] and 0 < new_column < width:
                moved[new_row, new_column, 0] = np.float32(flow[row, column, 0] * x)
                moved[new_row, new_column, 1] = np.float32(flow[row, column, 1] * y)
                known[new_row, new_column] = True
    return moved, known
