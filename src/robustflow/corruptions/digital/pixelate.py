"""Pixelate frames, bit-identical to Pillow: downscale with a box filter and upscale with nearest neighbour.

A box filter weights its n pixels equally, so an output pixel is (sum * round(2**22 / n) + 2**21) >> 22. Columns are
downscaled first, then rows, with 8-bit intermediate values (as in Pillow 10; for tall images, Pillow 13 starts with the
rows, and results may differ by one grey level).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.types import Frame
from ..base import Corruption


class Pixelate(Corruption):
    """Shrinks frames with a box filter and enlarges them; the severity parameter is the scale factor (paper,
    "Pixelation").
    """

    name = "pixelate"
    family = "digital"
    paper_severities = (0.6, 0.5, 0.4, 0.3, 0.25)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        return pixelated(frame, state)


_HALF = 1 << 21


class _AxisResize(NamedTuple):
    """Index tables for downscaling an axis from `size` to `small` pixels and upscaling it again."""

    first: npt.NDArray[np.int64]  # (small,) first pixel in the box
    covered: npt.NDArray[np.int64]  # (small,) number of pixels in the box
    weight: npt.NDArray[np.uint32]  # (small,) round(2**22 / covered)
    nearest: npt.NDArray[np.int64]  # (size,) nearest pixel of the small axis


@lru_cache(maxsize=64)
def _axis_resize(size: int, small: int) -> _AxisResize:
    scale = size / small
    centre = (np.arange(small) + 0.5) * scale
    first = np.maximum((centre - 0.5 * scale + 0.5).astype(np.int64), 0)
    last = np.minimum((centre + 0.5 * scale + 0.5).astype(np.int64), size) - 1
    first += (first - centre + 0.5) / scale <= -0.5
    last -= (last - centre + 0.5) / scale > 0.5
    covered = last - first + 1
    step = np.full(size, small / size)
    step[0] *= 0.5
    nearest = np.minimum(np.add.accumulate(step).astype(np.int64), small - 1)
    return _AxisResize(first, covered, np.floor(2.0**22 / covered + 0.5).astype(np.uint32), nearest)


def pixelated(frame: Frame, factor: float) -> Frame:
    """Downscale `frame`, uint8 (H, W, 3), to int(factor * size) with a box filter and upscale it again."""
    height, width = frame.shape[:2]
    rows = _axis_resize(height, max(1, int(height * factor)))
    columns = _axis_resize(width, max(1, int(width * factor)))
    narrow = np.empty((height, 3 * columns.first.size), np.uint8)
    fewest = int(columns.covered.min())
    most = int(columns.covered.max())
    picks = (columns.covered - fewest) * 3 * width + 3 * columns.first
    weights = np.array([columns.weight[columns.covered == n][:1].sum() for n in range(fewest, most + 1)], np.uint32)
    _shrink_columns(np.require(frame, requirements=("C", "W")).reshape(height, -1), picks, fewest, weights, narrow)
    small = np.empty((rows.first.size, narrow.shape[1]), np.uint8)
    _shrink_rows(narrow, rows.first, rows.covered, rows.weight, small)
    out = np.empty((height, 3 * width), np.uint8)
    _grow(small, rows.nearest, columns.nearest, out)
    return out.reshape(height, width, 3)


@njit(cache=True, nogil=True)
def _shrink_columns(source: Any, picks: Any, fewest: Any, weights: Any, out: Any) -> None:
    """Compute box sums of every required width at every position in a loop that vectorises, then select the required
    sums.
    """
    width = source.shape[1]
    sums = np.empty(width, np.uint32)
    means = np.empty(weights.size * width, np.uint8)
    for y in range(source.shape[0]):
        s = source[y]
        sums[:] = 0
        for n in range(1, fewest + weights.size):
            tail = s[3 * (n - 1) :]
            for x in range(tail.size):
                sums[x] += tail[x]
            if n >= fewest:
                weight, begin = weights[n - fewest], (n - fewest) * width
                mean = means[begin : begin + width]
                for x in range(width):
                    mean[x] = (sums[x] * weight + np.uint32(_HALF)) >> np.uint32(22)
        o = out[y]
        for i in range(picks.size):
            p, q = means[picks[i] : picks[i] + 3], o[3 * i : 3 * i + 3]
            q[0], q[1], q[2] = p[0], p[1], p[2]


@njit(cache=True, nogil=True)
def _shrink_rows(source: Any, first: Any, count: Any, weight: Any, out: Any) -> None:
    sums = np.empty(source.shape[1], np.uint32)
    for y in range(out.shape[0]):
        sums[:] = 0
        for n in range(count[y]):
            s = source[first[y] + n]
            for x in range(sums.size):
                sums[x] += s[x]
        o = out[y]
        for x in range(sums.size):
            o[x] = (sums[x] * weight[y] + np.uint32(_HALF)) >> np.uint32(22)


@njit(cache=True, nogil=True)
def _grow(small: Any, rows: Any, columns: Any, out: Any) -> None:
    for y in range(rows.size):
        o = out[y]
        if y > 0 and rows[y] == rows[y - 1]:
            above = out[y - 1]
            for x in range(o.size):
                o[x] = above[x]
            continue
        s = small[rows[y]]
        for x in range(columns.size):
            p, q = s[3 * columns[x] : 3 * columns[x] + 3], o[3 * x : 3 * x + 3]
            q[0], q[1], q[2] = p[0], p[1], p[2]
