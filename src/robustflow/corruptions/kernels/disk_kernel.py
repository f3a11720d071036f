"""Split the anti-aliased disk used for defocus blur into the parts summed by disk.py.

The kernel is a uniform disk blurred with a tiny Gaussian g (3 or 5 taps) inside an array. If the distance between the
disk and the edge of the array is less than the radius of g (for the paper's disk radii 8 and 10), the reference code
mirrors the disk at the edge, so the part that g would spread outside is reflected back inside: in each direction, a few
segments of the disk's outermost rows or columns are added and a few are subtracted. These segments form the kernel's
rim.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_NEGLIGIBLE = 1e-9
"""Taps of g below this value are set to zero; for a smoothing of 0.1 px, they are about 1e-22."""

_ROOM = 8
"""Minimum distance from the array's centre to its edge; larger disks use a larger array."""


class DiskParts(NamedTuple):
    """The parts of the kernel that are summed separately."""

    widths: npt.NDArray[np.int64]
    """Half-width of the disk in each row dy, int64 (int(radius) + 1,)."""
    taps: npt.NDArray[np.float32]
    """One half of g, starting at the centre, divided by the square root of the disk's area, float32 (g + 1,)."""
    rim: npt.NDArray[np.int64]
    """(distance, half-width) of a segment to add and of a segment to subtract, int64 (n, 4); a half-width of -1 means
    that there is no segment.
    """
    rim_weights: npt.NDArray[np.float32]
    """Weights of the segment pairs, float32 (n,), in the same units as `taps`."""


def _smoothing_taps(radius: float, smoothing: float) -> npt.NDArray[np.float64]:
    """Return one half of g, starting at the centre; without smoothing, this is only the centre tap."""
    if smoothing == 0:
        return np.ones(1)
    half = np.exp(-0.5 * (np.arange(2 if radius <= _ROOM else 3) / smoothing) ** 2)
    half /= half[0] + 2 * half[1:].sum()
    return half[half > _NEGLIGIBLE]


@lru_cache(maxsize=16)
def disk_parts(radius: float, smoothing: float) -> DiskParts:
    """Compute the parts of the kernel for a radius and a smoothing in pixels."""
    whole = int(radius)
    widths = np.array([isqrt(int(radius**2) - dy**2) for dy in range(whole + 1)])
    taps = _smoothing_taps(radius, smoothing)
    area = int((2 * widths + 1).sum() * 2 - (2 * widths[0] + 1))
    scale = area**-0.5
    # a rim segment is weighted by the tap of g and again by the blur perpendicular to it
    rim = [entry for entry in _mirrored_rim(whole, len(taps) - 1) if entry[2] <= whole]
    segments = [
        (inside, widths[row], *((outside, widths[other]) if other <= whole else (0, -1)))
        for _, inside, row, outside, other in rim
    ]
    weights = [taps[j] * scale for j, *_ in rim]
    table = np.array(segments, np.int64).reshape(-1, 4)
    return DiskParts(widths, (taps * scale).astype(np.float32), table, np.array(weights, np.float32))


def _mirrored_rim(radius: int, reach: int) -> list[tuple[int, int, int, int, int]]:
    """Return the segments that mirroring adds to, and subtracts from, the disk blurred with taps up to `reach`."""
    edge = max(radius, _ROOM)
    pairs = [(over, j) for over in range(1, reach + 1) for j in range(over, reach + 1)]
    return [(j, edge + over - j, edge - over, edge + over, edge + over - j) for over, j in pairs]
