"""Positions of the patches at a scale, their initial displacements, and their search area."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import inner
from .pyramid import Image, with_border

_TAPS = 3
"""Number of pixels around a patch that are needed for interpolation."""


def grid(size: int, patch: int, stride: int) -> npt.NDArray[np.int64]:
    """Return the start of each patch along an axis: every `stride` pixels, with the last patch flush with the end."""
    return np.append(np.arange(0, size - patch, stride, dtype=np.int64), size - patch)


def search_area(image: Image, patch: int) -> Image:
    """Pad frame 2 by edge replication, as far as `in_search_area` allows patches to move."""
    return with_border(image, patch + _TAPS)


@inner
def in_search_area(place: float, size: int, patch: int) -> tuple[int, float]:
    """Return the integer and fractional parts of the coordinate in `search_area` of a patch at `place` in frame 2."""
    inside = min(max(place, float(-patch)), float(size)) + (patch + _TAPS)
    whole = int(inside)
    return whole, inside - whole


@inner
def from_coarser(coarse: Any, y: float, x: float) -> tuple[float, float]:
    """Return (u, v) at a position in pixels of the finer scale: twice the coarse flow, interpolated bilinearly."""
    height, width, _ = coarse.shape
    at_y = min(max((y + 0.5) / 2 - 0.5, 0.0), height - 1.0)
    at_x = min(max((x + 0.5) / 2 - 0.5, 0.0), width - 1.0)
    y0, x0 = int(at_y), int(at_x)
    y1, x1 = min(y0 + 1, height - 1), min(x0 + 1, width - 1)
    b, a = at_y - y0, at_x - x0
    w00, w01, w10, w11 = (1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a
    u = w00 * coarse[y0, x0, 0] + w01 * coarse[y0, x1, 0] + w10 * coarse[y1, x0, 0] + w11 * coarse[y1, x1, 0]
    v = w00 * coarse[y0, x0, 1] + w01 * coarse[y0, x1, 1] + w10 * coarse[y1, x0, 1] + w11 * coarse[y1, x1, 1]
    return 2 * u, 2 * v
