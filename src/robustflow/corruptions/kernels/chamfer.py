"""Compute the distance to the nearest edge in integer arithmetic.

OpenCV's `distanceTransform` may use Intel IPP, which changes the last bits of the floats; after rounding, the results
can differ by a grey level. The weights are those of OpenCV's 5 x 5 mask: 1, 1.4 and 2.1969.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import njit

_STRAIGHT, _DIAGONAL, _KNIGHT = 10_000, 14_000, 21_969


def chamfer_distance(edges: npt.NDArray[np.uint8], limit: int) -> npt.NDArray[np.int32]:
    """Compute the chamfer distance to the nearest nonzero pixel, int32 (H, W) in 1/10000 px, at most `limit` px."""
    far = limit * _STRAIGHT
    distance = np.where(edges > 0, 0, far).astype(np.int32)
    for _ in range(2):  # first from the upper left, then from the lower right
        _sweep(distance, far, np.full((2, distance.shape[1] + 4), far, np.int32))
        distance = np.ascontiguousarray(distance[::-1, ::-1])  # contiguous, so the loops are compiled only once
    return distance


def mean_distance(distance: npt.NDArray[np.int32]) -> npt.NDArray[np.uint8]:
    """Compute the mean distance in each 3 x 3 neighbourhood in pixels, rounded down: uint8 (H, W). Borders are
    mirrored.
    """
    sums = cv2.boxFilter(distance, cv2.CV_32S, (3, 3), normalize=False, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(sums // (9 * _STRAIGHT), np.uint8)


@njit(cache=True, nogil=True)
def _sweep(distance: Any, far: int, above: Any) -> None:
    """Propagate shortest paths from the left and from the rows above; a work array contains the latest two of them,
    with a margin of two pixels.
    """
    height, width = distance.shape
    line = np.empty(width, np.int32)
    for y in range(height):
        one, two = above[(y + 1) % 2], above[y % 2]
        for x in range(width):
            straight = np.int32(one[x + 2] + _STRAIGHT)
            diagonal = np.int32(min(one[x + 1], one[x + 3]) + _DIAGONAL)
            knight = np.int32(min(min(one[x], one[x + 4]), min(two[x + 1], two[x + 3])) + _KNIGHT)
            line[x] = min(min(straight, diagonal), knight)
        row = distance[y]
        left = np.int32(far)
        for x in range(width):
            left = np.int32(min(min(row[x], line[x]), np.int32(left + _STRAIGHT)))
            row[x] = left
            two[x + 2] = left
