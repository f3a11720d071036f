"""From displacements of patches to flow of pixels (Kroeger et al. 2016, section 2.2, equation 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiled import njit
from ...sample import Flow
from .patches import grid, in_search_area, search_area
from .pyramid import Image
from .search import Displacements


def densified(image1: Image, image2: Image, displacements: Displacements, patch: int, stride: int) -> Flow:
    """Every pixel's flow: the mean of the displacements u_i of the patches that cover it.

    Their weights are 1 / max(1, |d_i|), with d_i the difference of colour, in grey levels, between the pixel in frame 1
    and where u_i puts it in frame 2: the patches that explain the pixel count.

    Args:
        image1, image2: float32 (H, 3 W) interleaved RGB.
        displacements: of `inverse_search` with the same `patch` and `stride`.

    Returns:
        float32 (H, W, 2).
    """
    height, width = image1.shape[0], image1.shape[1] // 3
    total = np.zeros((height, width, 2), np.float32)
    rows, columns = grid(height, patch, stride), grid(width, patch, stride)
    _spread(image1, search_area(image2, patch), rows, columns, displacements, patch, total)
    return total


@njit(cache=True, nogil=True)
def _spread(image1: Any, image2: Any, rows: Any, columns: Any, displacements: Any, patch: int, total: Any) -> None:
    height, width, _ = total.shape
    weights = np.zeros((height, width), np.float32)
    squares = np.empty(3 * patch, np.float32)
    one = np.float32(1)
    for i in range(rows.size):
        for j in range(columns.size):
            y, x = rows[i], columns[j]
            u, v = displacements[i, j, 0], displacements[i, j, 1]
            y0, at_y = in_search_area(y + float(v), height, patch)
            x0, at_x = in_search_area(x + float(u), width, patch)
            wy, wx = np.float32(at_y), np.float32(at_x)
            w00, w01, w10, w11 = (one - wy) * (one - wx), (one - wy) * wx, wy * (one - wx), wy * wx
            for r in range(patch):
                here = image1[y + r, 3 * x : 3 * (x + patch)]
                above, below = image2[y0 + r, 3 * x0 :], image2[y0 + r + 1, 3 * x0 :]
                for k in range(3 * patch):
                    there = (w00 * above[k] + w01 * above[k + 3]) + (w10 * below[k] + w11 * below[k + 3])
                    squares[k] = (there - here[k]) * (there - here[k])
                for k in range(patch):
                    square = squares[3 * k] + squares[3 * k + 1] + squares[3 * k + 2]
                    weight = one / np.sqrt(max(one, square))
                    weights[y + r, x + k] += weight
                    total[y + r, x + k, 0] += weight * u
                    total[y + r, x + k, 1] += weight * v
    for y in range(height):
        for x in range(width):
            total[y, x, 0] /= weights[y, x]
            total[y, x, 1] /= weights[y, x]
