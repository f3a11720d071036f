"""Scaling, flipping and cropping of a training pair: what is drawn, and how it is applied to dense and sparse truth."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from ...compiled import njit
from ...random.rng import Rng
from ...sample import Flow, Frame, Mask

_SCALED = 0.8
"""Probability of scaling at all."""
_STRETCHED = 0.8
_STRETCH = 0.2
"""Largest stretch of one axis, a power of two."""
_FLIPPED = (0.5, 0.1)
"""Probability of flipping left-right and upside down."""
_MARGIN = {"dense": 8, "sparse": 1}
"""Pixels by which a scaled frame is at least larger than the crop."""
_OVERHANG = (20, 50)
"""Rows and columns by which the crop of a sparse pair may be drawn beyond the frame before it is moved back inside, so
that the borders are seen more often."""


class Geometry(NamedTuple):
    """One draw.

    Attributes:
        scale: factors (x, y), or None for frames that keep their size.
        mirrored, upside_down: flips.
        top, left: of the crop in the scaled, flipped frame.
    """

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
    """Draw the geometry as RAFT does for dense and for sparse ground truth.

    Frames smaller than the crop are always scaled; the original fails on them, and has none.

    Args:
        rng: the stream.
        shape: (H, W) of the frames.
        crop: (H, W) of what the network sees.
        log2_scale: range of the power of two by which frames are scaled.
        flip: whether frames are flipped; sparse ones only left-right.
        sparse: whether the truth is sparse: then no stretch, and crops that reach the borders more often.
    """
    height, width = shape
    margin = _MARGIN["sparse" if sparse else "dense"]
    least = max((crop[0] + margin) / height, (crop[1] + margin) / width)
    x = y = 2.0 ** rng.uniform(*log2_scale)
    if not sparse and rng.uniform() < _STRETCHED:
        x *= 2.0 ** rng.uniform(-_STRETCH, _STRETCH)
        y *= 2.0 ** rng.uniform(-_STRETCH, _STRETCH)
    scale = None
    if rng.uniform() < _SCALED or height <= crop[0] or width <= crop[1]:
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
        top, left = rng.integer(0, free[0]), rng.integer(0, free[1])
    return Geometry(scale, mirrored, upside_down, top, left)


def scaled_size(shape: tuple[int, int], scale: tuple[float, float]) -> tuple[int, int]:
    """(W, H) of frames of `shape` (H, W) after scaling by (x, y): rounded to even halves, as OpenCV and Python do."""
    return round(shape[1] * scale[0]), round(shape[0] * scale[1])


def warp_frame(frame: Frame, geometry: Geometry, crop: tuple[int, int]) -> Frame:
    """A frame scaled (bilinear, half-pixel centres), flipped and cropped; a new array, RGB uint8 (*crop, 3)."""
    if geometry.scale is not None:
        x, y = geometry.scale
        frame = cv2.resize(frame, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(_placed(frame, geometry, crop))


def without_border(frame: Frame, border: int) -> Frame:
    """A frame without `border` pixels on each side, enlarged to its size again as `warp_frame` scales; a new array.

    >>> without_border(np.arange(8, dtype=np.uint8).repeat(24).reshape(8, 8, 3), 2)[:, 0, 0].tolist()
    [2, 2, 3, 3, 4, 4, 5, 5]
    """
    height, width = frame.shape[:2]
    inner = frame[border : height - border, border : width - border]
    return cv2.resize(inner, (width, height), interpolation=cv2.INTER_LINEAR)


def warp_dense(flow: Flow, valid: Mask, geometry: Geometry, crop: tuple[int, int]) -> tuple[Flow, Mask]:
    """Warp dense flow, its vectors scaled and flipped with the frames. A pixel is valid if all four that it is
    interpolated from are."""
    if geometry.scale is not None:
        x, y = geometry.scale
        flow = cv2.resize(flow, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
        flow = flow * np.array([x, y], np.float32)
        if not valid.all():
            share = cv2.resize(valid.astype(np.float32), None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR)
            valid = np.asarray(share > 0.999)
        else:
            valid = np.ones(flow.shape[:2], bool)
    return _turned(_placed(flow, geometry, crop), geometry), np.ascontiguousarray(_placed(valid, geometry, crop))


def warp_sparse(flow: Flow, valid: Mask, geometry: Geometry, crop: tuple[int, int]) -> tuple[Flow, Mask]:
    """Warp sparse flow: each valid point moves to the pixel nearest to its new position; those that land in the first
    row or column, or outside, are lost, as in the original."""
    if geometry.scale is not None:
        width, height = scaled_size(flow.shape[:2], geometry.scale)
        flow, valid = _moved(np.ascontiguousarray(flow), valid, *geometry.scale, height, width)
    return _turned(_placed(flow, geometry, crop), geometry), np.ascontiguousarray(_placed(valid, geometry, crop))


def _placed(array: Any, geometry: Geometry, crop: tuple[int, int]) -> Any:
    """Flipped and cropped; a view."""
    if geometry.mirrored:
        array = array[:, ::-1]
    if geometry.upside_down:
        array = array[::-1]
    return array[geometry.top : geometry.top + crop[0], geometry.left : geometry.left + crop[1]]


def _turned(flow: Flow, geometry: Geometry) -> Flow:
    """The signs of vectors in flipped frames; a new array."""
    signs = [-1 if geometry.mirrored else 1, -1 if geometry.upside_down else 1]
    return np.ascontiguousarray(flow * np.array(signs, np.float32))


@njit(cache=True, nogil=True)
def _moved(flow: Any, valid: Any, x: Any, y: Any, height: Any, width: Any) -> Any:
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
