"""Interpolate frames with cubic splines, which are smooth and pass through every pixel.

Other interpolation methods blur by an amount that depends on the subpixel position, which biases matches towards
integer displacements. For a search at 1/8 resolution, this bias is up to 0.4 px at full resolution with Catmull-Rom
weights, and 0.1 px with splines.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import spline_filter1d

from ...compiled import njit
from .pyramid import Image


def coefficients(image: Image) -> Image:
    """Return the spline coefficients to be weighted by `spline_weights`, in the frame's shape; the frame is mirrored
    about its edge pixels.

    Args:
        image: image in interleaved RGB, float32 (H, 3 W), with H and W at least 2.

    >>> ramp = np.repeat(np.arange(12, dtype=np.float32), 3)[None].repeat(4, 0)
    >>> round(float(coefficients(ramp)[1, 15]), 2)
    5.0
    """
    pixels = image.reshape(image.shape[0], -1, 3)
    for axis in (0, 1):
        pixels = spline_filter1d(pixels, 3, axis, output=np.float64, mode="mirror")
    return pixels.astype(np.float32).reshape(image.shape)


@njit(cache=True, nogil=True)
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of the coefficients at -1, 0, 1 and 2 for a position `t` in [0, 1].

    >>> [round(6 * weight, 6) for weight in spline_weights(0.0)]
    [1.0, 4.0, 1.0, 0.0]
    """
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (4.0 + s * s * (3.0 * s - 6.0)) / 6.0,
        t * t * t / 6.0,
    )


@njit(cache=True, nogil=True)
def mirrored_once(index: int, size: int) -> int:
    """Mirror `index` about the edge pixels; it may be at most one pixel outside.

    >>> mirrored_once(-1, 8), mirrored_once(3, 8), mirrored_once(8, 8)
    (1, 3, 6)
    """
    return abs(index) if index < size else 2 * size - 2 - index
