"""Convolve with an anti-aliased disk in time proportional to the radius instead of the area.

The kernel is a uniform disk blurred with a tiny Gaussian g (3 or 5 taps) inside an array. If the distance between the
disk and the edge of the array is less than the radius of g (for the paper's disk radii 8 and 10), the reference code
mirrors the disk at the edge, so the part that g would spread outside is reflected back inside: in each direction, a few
segments of the disk's outermost rows or columns are added and a few are subtracted. These segments form the kernel's
rim.

The image is first summed exactly over a uniform disk, using differences of integer running sums along the rows; then
the result is blurred along both axes. The rim's row segments are added before the horizontal blur, its column segments
after it.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, inner, njit
from ...core.types import Frame
from .filters import FLOOR, mirrored

_NEGLIGIBLE = 1e-9
"""Taps of g below this value are set to zero; for a smoothing of 0.1 px, they are about 1e-22."""

_ROOM = 8
"""Minimum distance from the array's centre to its edge; larger disks use a larger array."""


class DiskParts(NamedTuple):
    """The parts of the kernel that are summed separately."""

    widths: npt.NDArray[np.int64]  # half-width of the disk in each row dy, int64 (int(radius) + 1,)
    taps: npt.NDArray[np.float32]
    """One half of g, starting at the centre, divided by the square root of the disk's area, float32 (g + 1,)."""
    rim: npt.NDArray[np.int64]
    """(distance, half-width) of a segment to add and of a segment to subtract, int64 (n, 4); a half-width of -1 means
    that there is no segment.
    """
    rim_weights: npt.NDArray[np.float32]  # weights of the segment pairs, float32 (n,), in the same units as `taps`


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


_U = np.uint64  # unsigned indices avoid numba's check for negative indices
_STRIP = 640
"""Number of columns processed at a time, chosen so that all rows needed for a sum fit in the L1 cache."""


def convolve_disk(frame: Frame, radius: float, smoothing: float, floor: bool = False) -> Frame:
    """Convolve a frame, uint8 (H, W, 3), with the anti-aliased disk; borders are mirrored."""
    height, width = frame.shape[:2]
    source = contiguous(frame).reshape(height, width * 3)
    out = np.empty_like(source)
    offset = np.float32(FLOOR if floor else 0)
    widths, taps, rim, rim_weights = disk_parts(radius, smoothing)
    tallest = int(rim[:, 1::2].max()) + 2 if len(rim) else 0
    for x in range(0, width, _STRIP):
        _convolve(source, x, widths, taps, rim, rim_weights, tallest, offset, out)
    return out.reshape(frame.shape)


@inner
def _running_sums(row: Any, start: int, sums: Any) -> None:
    """Compute the running sums of each channel, starting at column `start`; columns outside the row are mirrored."""
    width = row.size // 3
    r = g = b = np.int32(0)
    sums[0] = sums[1] = sums[2] = 0
    for j in range(sums.size // 3 - 1):
        x = start + j
        at = 3 * x if 0 <= x < width else 3 * mirrored(x, width)
        r = np.int32(r + row[at])
        g = np.int32(g + row[at + 1])
        b = np.int32(b + row[at + 2])
        to = 3 * j + 3
        sums[to], sums[to + 1], sums[to + 2] = r, g, b


@inner
def _add_segment(total: Any, row: Any, left: Any, right: Any) -> None:
    """Add a row segment, using start indices in a loop because numba compiles slices more slowly."""
    for i in range(_U(total.size)):
        total[i] = np.int32(total[i] + np.int32(row[right + i] - row[left + i]))


@inner
def _add_four_segments(total: Any, a: Any, b: Any, l0: Any, r0: Any, c: Any, d: Any, l1: Any, r1: Any) -> None:
    for i in range(_U(total.size)):
        first = np.int32(np.int32(a[r0 + i] - a[l0 + i]) + np.int32(b[r0 + i] - b[l0 + i]))
        second = np.int32(np.int32(c[r1 + i] - c[l1 + i]) + np.int32(d[r1 + i] - d[l1 + i]))
        total[i] = np.int32(total[i] + np.int32(first + second))


@inner
def _sum_disk(ring: Any, y: int, widths: Any, middle: int, total: Any) -> None:
    """Sum over the uniform disk around row `y`; total[0] is centred on column `middle` of the running sums."""
    window = len(ring)
    for i in range(total.size):
        total[i] = 0
    _add_segment(total, ring[y % window], _U(3 * (middle - widths[0])), _U(3 * (middle + widths[0] + 1)))
    dy = 1
    while dy + 1 < len(widths):
        a, b = ring[(y - dy) % window], ring[(y + dy) % window]
        c, d = ring[(y - dy - 1) % window], ring[(y + dy + 1) % window]
        l0, r0 = _U(3 * (middle - widths[dy])), _U(3 * (middle + widths[dy] + 1))
        l1, r1 = _U(3 * (middle - widths[dy + 1])), _U(3 * (middle + widths[dy + 1] + 1))
        _add_four_segments(total, a, b, l0, r0, c, d, l1, r1)
        dy += 2
    if dy < len(widths):
        l0, r0 = _U(3 * (middle - widths[dy])), _U(3 * (middle + widths[dy] + 1))
        _add_segment(total, ring[(y - dy) % window], l0, r0)
        _add_segment(total, ring[(y + dy) % window], l0, r0)


@inner
def _add_rim(total: Any, weight: Any, first: Any, second: Any, third: Any, fourth: Any) -> None:
    """Add two segments and subtract two, each given by running sums, its end and its start."""
    (a, r0, l0), (b, r1, l1), (c, r2, l2), (d, r3, l3) = first, second, third, fourth
    for i in range(_U(total.size)):
        inside = np.int32(np.int32(a[r0 + i] - a[l0 + i]) + np.int32(b[r1 + i] - b[l1 + i]))
        outside = np.int32(np.int32(c[r2 + i] - c[l2 + i]) + np.int32(d[r3 + i] - d[l3 + i]))
        total[i] += weight * np.float32(np.int32(inside - outside))


@inner
def _add_rim_rows(ring: Any, y: int, rim: Any, weights: Any, middle: int, total: Any) -> None:
    window = len(ring)
    for k in range(len(rim)):
        d, h, e, g = rim[k, 0], rim[k, 1], rim[k, 2], rim[k, 3]
        a, b = ring[(y - d) % window], ring[(y + d) % window]
        p, q = ring[(y - e) % window], ring[(y + e) % window]
        left, right = _U(3 * (middle - h)), _U(3 * (middle + h + 1))
        first, last = _U(3 * (middle - g)), _U(3 * (middle + g + 1))
        if g < 0:
            first = last
        _add_rim(total, weights[k], (a, right, left), (b, right, left), (p, last, first), (q, last, first))


@inner
def _add_three(a: Any, b: Any, c: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = np.int32(a[i] + np.int32(b[i] + c[i]))


@inner
def _add_rim_columns(ring: Any, y: int, rim: Any, weights: Any, middle: int, columns: Any, total: Any) -> None:
    """Compute the rim; `columns[h]` is a buffer for the running sums over rows y - h to y + h, and `columns[-1]` is
    zero.
    """
    window = len(ring)
    row, first_sums = ring[y % window], columns[0]
    for i in range(row.size):  # slice assignment would take three seconds longer to compile
        first_sums[i] = row[i]
    for h in range(1, len(columns) - 1):
        _add_three(columns[h - 1], ring[(y - h) % window], ring[(y + h) % window], columns[h])
    three = _U(3)
    for k in range(len(rim)):
        d, h, e, g = rim[k, 0], rim[k, 1], rim[k, 2], rim[k, 3]
        a, b = columns[h], columns[g]
        left, right = _U(3 * (middle - d)), _U(3 * (middle + d))
        first, last = _U(3 * (middle - e)), _U(3 * (middle + e))
        added, removed = (a, left + three, left), (b, first + three, first)
        _add_rim(total, weights[k], added, (a, right + three, right), removed, (b, last + three, last))


@inner
def _weigh(rows: Any, y: int, taps: Any, out: Any) -> None:
    """Blur vertically: apply `taps` to rows y - g to y + g of a ring buffer."""
    window = len(rows)
    row = rows[y % window]
    for i in range(out.size):
        out[i] = taps[0] * row[i]
    for j in range(1, len(taps)):
        a, b = rows[(y - j) % window], rows[(y + j) % window]
        for i in range(out.size):
            out[i] += taps[j] * (a[i] + b[i])


@njit(cache=True, nogil=True)
def _convolve(
    source: Any, x0: int, widths: Any, taps: Any, rim: Any, rim_weights: Any, tallest: int, offset: Any, out: Any
) -> None:
    """Compute the strip of columns that starts at column `x0`; the rim requires `tallest` rows of sums."""
    height, n = out.shape[0], min(3 * _STRIP, out.shape[1] - 3 * x0)
    g = len(taps) - 1
    reach = len(widths) - 1 + g
    window = 2 * reach + 1
    sums = np.empty((window, n + 3 * window), np.int32)
    disk = np.empty(n + 6 * g, np.int32)
    disks = np.empty((2 * g + 1, disk.size), np.float32)
    columns = np.zeros((tallest, sums.shape[1]), np.int32)
    sides = np.zeros((2 * g + 1, n), np.float32)
    down = np.empty(disk.size, np.float32)
    total = np.empty(n, np.float32)
    for y in range(-reach, reach - 2 * g):
        _running_sums(source[mirrored(y, height)], x0 - reach, sums[y % window])
    for y in range(-2 * g, height):
        ahead = y + g
        _running_sums(source[mirrored(y + reach, height)], x0 - reach, sums[(y + reach) % window])
        _sum_disk(sums, ahead, widths, reach - g, disk)
        row = disks[ahead % len(disks)]
        for i in range(row.size):
            row[i] = np.float32(disk[i])
        if len(rim) > 0:
            side = sides[ahead % len(sides)]
            for i in range(n):
                side[i] = 0
            _add_rim_columns(sums, ahead, rim, rim_weights, reach, columns, side)
        if y < 0:
            continue
        _weigh(disks, y, taps, down)
        _add_rim_rows(sums, y, rim, rim_weights, reach - g, down)
        _weigh(sides, y, taps, total)
        for j in range(g + 1):
            a, b = down[3 * (g - j) : 3 * (g - j) + n], down[3 * (g + j) : 3 * (g + j) + n]
            tap = taps[j] if j > 0 else taps[j] * np.float32(0.5)
            for i in range(n):
                total[i] += tap * (a[i] + b[i])
        target = out[y, 3 * x0 : 3 * x0 + n]
        for i in range(n):
            target[i] = np.uint8(np.rint(min(max(total[i] + offset, np.float32(0)), np.float32(255))))
