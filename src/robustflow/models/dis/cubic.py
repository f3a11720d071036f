"""Catmull-Rom interpolation: four taps along an axis, through the pixels, without the blur of bilinear interpolation.

That blur depends on the fraction of a pixel and pulls sub-pixel matches towards whole pixels.
"""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True)
def cubic_weights(t: float) -> tuple[float, float, float, float]:
    """Weights of the pixels at -1, 0, 1 and 2 for a place `t` in [0, 1].

    >>> cubic_weights(0.5)
    (-0.0625, 0.5625, 0.5625, -0.0625)
    """
    return (
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (2.0 + t * t * (3.0 * t - 5.0)),
        0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
        0.5 * t * t * (t - 1.0),
    )
