"""Interpolate frames with cubic splines, which are smooth and pass through every pixel.

Other interpolation methods blur by an amount that depends on the subpixel position, which biases matches towards
integer displacements. For a search at 1/8 resolution, this bias is up to 0.4 px at full resolution with Catmull-Rom
weights, and 0.1 px with splines.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...compiled import njit
from .pyramid import Image

_POLE = math.sqrt(3) - 2
_MEMORY = 32
"""Number of pixels after which the influence of a pixel, `_POLE**i`, is less than the rounding error of float64."""


def coefficients(image: Image) -> Image:
    """Return the spline coefficients to be weighted by `spline_weights`, in the frame's shape; the frame is mirrored
    about its edge pixels.
    """
    height, columns = image.shape
    weighed = image.astype(np.float64)
    _filter(weighed)
    for row in weighed.reshape(height, columns // 3, 3):
        _filter(row)
    return weighed.astype(np.float32)


@njit(cache=True, nogil=True)
def _filter(lines: Any) -> None:
    """Replace the pixels along the first axis of float64 (N, K) by their spline coefficients (Unser 1999, box 2)."""
    size, columns = lines.shape
    first, power = lines[0].copy(), 1.0
    for i in range(1, _MEMORY):
        power *= _POLE
        place = i % (2 * size - 2)
        other = lines[min(place, 2 * size - 2 - place)]
        for k in range(columns):
            first[k] += power * other[k]
    for k in range(columns):
        lines[0, k] = 6.0 * first[k]
    for i in range(1, size):
        for k in range(columns):
            lines[i, k] = 6.0 * lines[i, k] + _POLE * lines[i - 1, k]
    for k in range(columns):
        lines[size - 1, k] = (_POLE * lines[size - 2, k] + lines[size - 1, k]) * (_POLE / (_POLE * _POLE - 1.0))
    for i in range(size - 2, -1, -1):
        for k in range(columns):
            lines[i, k] = _POLE * (lines[i + 1, k] - lines[i, k])


@njit(cache=True, nogil=True)
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of the coefficients at -1, 0, 1 and 2 for a position `t` in [0, 1]."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (4.0 + s * s * (3.0 * s - 6.0)) / 6.0,
        t * t * t / 6.0,
    )


@njit(cache=True, nogil=True)
def mirrored_once(index: int, size: int) -> int:
    """Mirror `index` about the edge pixels; it may be at most one pixel outside."""
    return abs(index) if index < size else 2 * size - 2 - index
