"""Generate a plasma fractal for use as a fog map, with the diamond-square algorithm.

A square torus with 2**k points per side starts as a single point of value 0 and is doubled k times; each new point is
the mean of its four neighbours plus uniform noise with an amplitude of 10000 / decay**(2 * level). The noise is a hash
of the point's position, so any part can be refined separately: the full torus is computed up to 512 x 512, and beyond
that only the visible corner.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import inner, njit
from ...random.rng import Rng, hash64

_WHOLE = 512
_AMPLITUDE = 100.0


def plasma_corner(rng: Rng, height: int, width: int, decay: float) -> npt.NDArray[np.float32]:
    """Return the top left corner, float32 (height, width) in [0, 1], of the smallest plasma map that contains it."""
    size = 1 << (max(height, width, 2) - 1).bit_length()
    grid = np.zeros((1, 1), np.float32)
    level = 0
    while len(grid) < min(size, _WHOLE):
        grid = _double(np.pad(grid, 1, mode="wrap"), -1, len(grid), *_noise(rng, level, decay))
        level += 1
    low, high = grid.min(), grid.max()
    if len(grid) < size:
        rows, columns = _points_needed(height, size // len(grid)), _points_needed(width, size // len(grid))
        start = -2  # two extra points before the corner at every level: doubling consumes one and doubles the other
        corner = np.take(grid, range(start, start + rows), 0, mode="wrap")
        corner = np.take(corner, range(start, start + columns), 1, mode="wrap")
        points = len(grid)
        while points < size:
            corner = _double(corner, start, points, *_noise(rng, level, decay))
            points *= 2
            level += 1
        grid = corner[-start:, -start:]
    corner = grid[:height, :width]
    low, high = min(low, corner.min()), max(high, corner.max())
    return (corner - low) / (high - low)


def _noise(rng: Rng, level: int, decay: float) -> tuple[np.uint64, np.float32]:
    return np.uint64(rng.spawn("plasma", level).key), np.float32((_AMPLITUDE / decay**level) ** 2)


def _points_needed(length: int, factor: int) -> int:
    """Return the number of points needed to cover `length` points and the margin after upscaling by `factor`."""
    points = length + 2
    while factor > 1:
        points = -(-points // 2) + 2
        factor //= 2
    return points


@inner
def _uniform(bits: Any, amplitude: Any) -> Any:
    """Convert the lowest 16 bits to a uniformly distributed number in +-amplitude."""
    return amplitude * (np.float32(np.int32(bits & np.uint64(0xFFFF))) * np.float32(2.0**-15) - np.float32(1))


@njit(cache=True, nogil=True)
def _double(coarse: Any, start: int, points: int, key: Any, amplitude: Any) -> Any:
    """Refine part of a torus with `points`**2 points, starting at row and column `start`."""
    rows, columns = coarse.shape
    fine = np.empty((2 * rows - 4, 2 * columns - 4), np.float32)
    above = np.empty(columns - 1, np.float32)
    centre = np.empty(columns - 1, np.float32)
    bits = np.empty(columns - 1, np.uint64)
    quarter = np.float32(0.25)
    for i in range(rows - 1):
        here, below = coarse[i], coarse[i + 1]
        first = np.uint64((start + i) % points) * np.uint64(points)
        for j in range(columns - 1):
            bits[j] = hash64(key, first + np.uint64((start + j) % points))
        for j in range(columns - 1):
            corners = (here[j] + here[j + 1]) + (below[j] + below[j + 1])
            centre[j] = corners * quarter + _uniform(bits[j], amplitude)
        if i > 0:
            even, odd = fine[2 * i - 2], fine[2 * i - 1]
            for j in range(1, columns - 1):
                right = (here[j] + here[j + 1]) + (above[j] + centre[j])
                down = (here[j] + below[j]) + (centre[j - 1] + centre[j])
                even[2 * j - 2] = here[j]
                even[2 * j - 1] = right * quarter + _uniform(bits[j] >> np.uint64(16), amplitude)
                odd[2 * j - 2] = down * quarter + _uniform(bits[j] >> np.uint64(32), amplitude)
                odd[2 * j - 1] = centre[j]
        above, centre = centre, above
    return fine
