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
from .filters import FLOOR

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
_ONE, _TWO = np.uint64(1), np.uint64(2)
_STRIP = 640
"""Number of columns processed at a time, chosen so that all rows needed for a sum fit in the L1 cache."""


def convolve_disk(frame: Frame, radius: float, smoothing: float, floor: bool = False) -> Frame:
    """Convolve a frame, uint8 (H, W, 3), with the anti-aliased disk; borders are mirrored."""
    height, width = frame.shape[:2]
    source = contiguous(frame).reshape(height, width * 3)
    out = np.empty_like(source)
    offset = np.float32(FLOOR if floor else 0)
    parts = disk_parts(radius, smoothing)
    reach = len(parts.widths) + len(parts.taps) - 2
    lines, pixels = (np.pad(np.arange(size, dtype=np.uint64), reach, mode="reflect") for size in (height, width))
    for x in range(0, width, _STRIP):
        columns = 3 * pixels[x : x + _STRIP + 2 * reach]
        work = _work_arrays(parts, 3 * (len(columns) - 2 * reach))
        _convolve(source, lines, columns, *parts, offset, work, 3 * x, out)
    return out.reshape(frame.shape)


def _work_arrays(parts: DiskParts, n: int) -> tuple[npt.NDArray[Any], ...]:
    """Return the arrays for a strip of rows of `n` values; compiled code that created them would take longer to
    compile.
    """
    g = len(parts.taps) - 1
    window = 2 * (len(parts.widths) + g) - 1
    sums = np.empty((window, n + 3 * window), np.int32)
    disk = np.empty(n + 6 * g, np.int32)
    rows = np.zeros((2 * g + 1, disk.size + n), np.float32)  # sums over the disk, and the columns of the rim
    blurred = np.empty(rows.shape[1], np.float32)
    tallest = int(parts.rim[:, 1::2].max()) + 2 if len(parts.rim) else 0
    columns = np.zeros((tallest, sums.shape[1]), np.int32)
    return sums, disk, rows, columns, blurred, blurred[: disk.size], blurred[disk.size :]


@inner
def _running_sums(source: Any, y: Any, columns: Any, sums: Any, to: Any) -> None:
    """Compute the running sums of each channel of row `y` at `columns`."""
    r = g = b = np.int32(0)
    sums[to, 0] = sums[to, 1] = sums[to, 2] = 0
    for j in range(columns.size):
        at = columns[j]
        r = np.int32(r + source[y, at])
        g = np.int32(g + source[y, at + _ONE])
        b = np.int32(b + source[y, at + _TWO])
        sums[to, 3 * j + 3], sums[to, 3 * j + 4], sums[to, 3 * j + 5] = r, g, b


@inner
def _sum_disk(ring: Any, y: int, widths: Any, middle: int, total: Any) -> None:
    """Sum over the uniform disk around row `y`; total[0] is centred on column `middle` of the running sums."""
    window, n = len(ring), _U(total.size)
    a = _U(y % window)
    l0, r0 = _U(3 * (middle - widths[0])), _U(3 * (middle + widths[0] + 1))
    for i in range(n):
        total[i] = np.int32(ring[a, r0 + i] - ring[a, l0 + i])
    for dy in range(1, len(widths), 2):
        more = np.minimum(dy + 1, len(widths) - 1)
        a, b = _U((y - dy) % window), _U((y + dy) % window)
        c, d = _U((y - more) % window), _U((y + more) % window)
        l0, r0 = _U(3 * (middle - widths[dy])), _U(3 * (middle + widths[dy] + 1))
        l1, r1 = _U(3 * (middle - widths[more])), _U(3 * (middle + widths[more] + 1))
        if more == dy:
            l1 = r1
        for i in range(n):
            first = np.int32(np.int32(ring[a, r0 + i] - ring[a, l0 + i]) + np.int32(ring[b, r0 + i] - ring[b, l0 + i]))
            second = np.int32(np.int32(ring[c, r1 + i] - ring[c, l1 + i]) + np.int32(ring[d, r1 + i] - ring[d, l1 + i]))
            total[i] = np.int32(total[i] + np.int32(first + second))


@inner
def _add_rim(total: Any, weight: Any, sums: Any, first: Any, second: Any, third: Any, fourth: Any) -> None:
    """Add two segments and subtract two, each given by its row of the running sums, its end and its start."""
    (a, r0, l0), (b, r1, l1), (c, r2, l2), (d, r3, l3) = first, second, third, fourth
    for i in range(_U(total.size)):
        inside = np.int32(np.int32(sums[a, r0 + i] - sums[a, l0 + i]) + np.int32(sums[b, r1 + i] - sums[b, l1 + i]))
        outside = np.int32(np.int32(sums[c, r2 + i] - sums[c, l2 + i]) + np.int32(sums[d, r3 + i] - sums[d, l3 + i]))
        total[i] += weight * np.float32(np.int32(inside - outside))


@inner
def _add_rim_rows(ring: Any, y: int, rim: Any, weights: Any, middle: int, total: Any) -> None:
    """Add the smoothed rim: line k of `rim` has two row offsets and their half widths, `weights` (K,) the taps."""
    window = len(ring)
    for k in range(len(rim)):
        d, h, e, g = rim[k, 0], rim[k, 1], rim[k, 2], rim[k, 3]
        a, b = _U((y - d) % window), _U((y + d) % window)
        p, q = _U((y - e) % window), _U((y + e) % window)
        left, right = _U(3 * (middle - h)), _U(3 * (middle + h + 1))
        first, last = _U(3 * (middle - g)), _U(3 * (middle + g + 1))
        if g < 0:
            first = last
        _add_rim(total, weights[k], ring, (a, right, left), (b, right, left), (p, last, first), (q, last, first))


@inner
def _add_rim_columns(ring: Any, y: int, rim: Any, weights: Any, middle: int, columns: Any, total: Any) -> None:
    """Compute the rim; `columns[h]` is a buffer for the running sums over rows y - h to y + h, and `columns[-1]` is
    zero.
    """
    window, tallest = len(ring), len(columns)
    for h in range(tallest - 1):
        a, b = _U((y - h) % window), _U((y + h) % window)
        for i in range(_U(ring.shape[1])):
            columns[h, i] = np.int32(columns[h - 1, i] + np.int32(ring[a, i] + ring[b, i])) if h > 0 else ring[a, i]
    three = _U(3)
    for k in range(len(rim)):
        d, e, p, q = rim[k, 0], rim[k, 2], _U(rim[k, 1]), _U(rim[k, 3] % tallest)
        left, right = _U(3 * (middle - d)), _U(3 * (middle + d))
        first, last = _U(3 * (middle - e)), _U(3 * (middle + e))
        added, removed = (p, left + three, left), (q, first + three, first)
        _add_rim(total, weights[k], columns, added, (p, right + three, right), removed, (q, last + three, last))


@inner
def _weigh(rows: Any, y: int, taps: Any, out: Any) -> None:
    """Blur vertically: apply `taps` to rows y - g to y + g of a ring buffer."""
    window, n = len(rows), _U(out.size)
    a = _U(y % window)
    for i in range(n):
        out[i] = taps[0] * rows[a, i]
    for j in range(1, len(taps)):
        a, b = _U((y - j) % window), _U((y + j) % window)
        for i in range(n):
            out[i] += taps[j] * (rows[a, i] + rows[b, i])


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(
    source: Any,
    lines: Any,
    pixels: Any,
    widths: Any,
    taps: Any,
    rim: Any,
    rim_weights: Any,
    offset: Any,
    work: Any,
    left: int,
    out: Any,
) -> None:
    """Compute the strip of columns that starts at value `left` of each row; `lines` and `pixels` are the rows and the
    starts of the pixels that it needs.
    """
    sums, disk, rows, columns, blurred, down, total = work
    n, g, window = _U(total.size), len(taps) - 1, len(sums)
    reach = window // 2
    for y in range(-2 * reach, out.shape[0]):
        _running_sums(source, lines[y + 2 * reach], pixels, sums, (y + reach) % window)
        if y < -2 * g:
            continue
        ahead = y + g
        _sum_disk(sums, ahead, widths, reach - g, disk)
        row = rows[ahead % len(rows)]
        for i in range(disk.size):
            row[i] = np.float32(disk[i])
        if len(rim) > 0:
            side = row[disk.size :]
            for i in range(n):
                side[i] = 0
            _add_rim_columns(sums, ahead, rim, rim_weights, reach, columns, side)
        if y < 0:
            continue
        _weigh(rows, y, taps, blurred)
        _add_rim_rows(sums, y, rim, rim_weights, reach - g, down)
        for j in range(g + 1):
            a, b = down[3 * (g - j) :], down[3 * (g + j) :]  # slices, without which this loop takes twice as long
            tap = taps[j] if j > 0 else taps[j] * np.float32(0.5)
            for i in range(n):
                total[i] += tap * (a[i] + b[i])
        for i in range(n):
            level = min(max(total[i] + offset, np.float32(0)), np.float32(255))
            out[y, _U(left) + i] = np.uint8(np.rint(level))
