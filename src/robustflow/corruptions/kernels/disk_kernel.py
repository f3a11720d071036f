"""Split the anti-aliased disk of the defocus blur into the parts summed by disk.py.

The kernel is a flat disk blurred by a tiny Gaussian g (3 or 5 taps) inside an array. If the disk is closer to the
array's edge than the reach of g (radius 8 and 10 of the paper's five), the reference code mirrors it at the edge, and
the part that g would spread outside is reflected inside: in each direction a few segments of the disk's outermost rows
or columns are added and a few are subtracted. These segments are the kernel's rim.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_NEGLIGIBLE = 1e-9
"""Taps of g below this value are set to zero; with a smoothing of 0.1 px they are about 1e-22."""

_ROOM = 8
"""Smallest distance from the array's centre to its edge; a larger disk enlarges the array."""


class DiskParts(NamedTuple):
    """Parts of the kernel."""

    widths: npt.NDArray[np.int64]
    """Half-width of each row dy of the disk, int64 (int(radius) + 1,)."""
    taps: npt.NDArray[np.float32]
    """Half of g, starting at the centre, float32 (g + 1,), divided by the square root of the disk's area."""
    rim: npt.NDArray[np.int64]
    """(distance, half-width) of a segment to add and of one to subtract, int64 (n, 4); a half-width of -1 means no
    segment.
    """
    rim_weights: npt.NDArray[np.float32]
    """Weights of the segment pairs, float32 (n,), in the units of `taps`."""


def _smoothing_taps(radius: float, smoothing: float) -> npt.NDArray[np.float64]:
    """Return half of g, starting at the centre; only the centre tap if there is no smoothing."""
    if smoothing == 0:
        return np.ones(1)
    half = np.exp(-0.5 * (np.arange(2 if radius <= _ROOM else 3) / smoothing) ** 2)
    half /= half[0] + 2 * half[1:].sum()
    return half[half > _NEGLIGIBLE]


@lru_cache(maxsize=16)
def disk_parts(radius: float, smoothing: float) -> DiskParts:
    """Compute the parts of the kernel for a radius and a smoothing in pixels.

    The paper's radii are integers; in general the disk contains the pixels whose centres it covers.
    """
    whole = int(radius)
    widths = np.array([isqrt(int(radius**2) - dy**2) for dy in range(whole + 1)])
    taps = _smoothing_taps(radius, smoothing)
    area = int((2 * widths + 1).sum() * 2 - (2 * widths[0] + 1))
    scale = area**-0.5
    # a rim segment is weighted once by g's tap and once more by the blur across it
    rim = [entry for entry in _mirrored_rim(whole, len(taps) - 1) if entry[2] <= whole]
    segments = [
        (inside, widths[row], *((outside, widths[other]) if other <= whole else (0, -1)))
        for _, inside, row, outside, other in rim
    ]
    weights = [taps[j] * scale for j, *_ in rim]
    table = np.array(segments, np.int64).reshape(-1, 4)
    return DiskParts(widths, (taps * scale).astype(np.float32), table, np.array(weights, np.float32))


def _mirrored_rim(radius: int, reach: int) -> list[tuple[int, int, int, int, int]]:
    """Return the segments that mirroring adds to and subtracts from the disk blurred by taps up to `reach`.

    Each item is (tap, distance and row of the disk to add, distance and row of the disk to subtract): tap j moves a row
    `over` pixels beyond the edge, where it is mirrored back.
    """
    edge = max(radius, _ROOM)
    pairs = [(over, j) for over in range(1, reach + 1) for j in range(over, reach + 1)]
    return [(j, edge + over - j, edge - over, edge + over, edge + over - j) for over, j in pairs]
