"""Bilinear interpolation, pixel by pixel."""

from __future__ import annotations

import numpy as np


def bilinear(image: np.ndarray, x: float, y: float) -> float:
    """Value at (x, y), zero outside."""
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    value = 0.0
    for row, wy in ((y0, y0 + 1 - y), (y0 + 1, y - y0)):
        for column, wx in ((x0, x0 + 1 - x), (x0 + 1, x - x0)):
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                value += wx * wy * image[row, column]
    return value
