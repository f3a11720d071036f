"""Convolution with an anti-aliased disk in a time that grows with its radius, not its area.

The image is first summed over the flat disk, exactly, as differences of integer running sums along the rows; the sum is
then blurred down and along. The rim (see disk_kernel.py) is added as rows before, and as columns after, the blur along
the row.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ...images.contiguous import contiguous
from ...sample import Frame
from .borders import mirrored
from .disk_kernel import disk_parts
from .separable import FLOOR

_STRIP = 640
"""Columns worked on at a time: few enough for the rows that a sum reads to stay in the first-level cache."""


def convolve_disk(frame: Frame, radius: float, smoothing: float, floor: bool = False) -> Frame:
    """The frame convolved with the kernel of disk_kernel.py: uint8 (H, W, 3) in and out, borders mirrored.

    Rounds once, or cuts the fraction off with `floor`.
    """
    height, width = frame.shape[:2]
    source = contiguous(frame).reshape(height, width * 3)
    out = np.empty_like(source)
    offset = np.float32(FLOOR if floor else 0)
    widths, taps, rim, rim_weights = disk_parts(radius, smoothing)
    tallest = int(rim[:, 1::2].max()) + 2 if len(rim) else 0
    for x in range(0, width, _STRIP):
        _convolve(source, x, widths, taps, rim, rim_weights, tallest, offset, out[:, 3 * x : 3 * (x + _STRIP)])
    return out.reshape(frame.shape)


@njit(cache=True, nogil=True)
def _running_sums(row: Any, start: int, sums: Any) -> None:
    """Running sums of each channel from column `start` on, columns outside the row mirrored.

    sums[3 * (j + 1) + c] - sums[3 * i + c] is the sum of channel c over columns start + i, ..., start + j.
    """
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


@njit(cache=True, nogil=True)
def _add_segment(total: Any, right: Any, left: Any) -> None:
    for i in range(total.size):
        total[i] = np.int32(total[i] + np.int32(right[i] - left[i]))


@njit(cache=True, nogil=True)
def _add_four_segments(total: Any, r0: Any, l0: Any, r1: Any, l1: Any, r2: Any, l2: Any, r3: Any, l3: Any) -> None:
    for i in range(total.size):
        first = np.int32(np.int32(r0[i] - l0[i]) + np.int32(r1[i] - l1[i]))
        second = np.int32(np.int32(r2[i] - l2[i]) + np.int32(r3[i] - l3[i]))
        total[i] = np.int32(total[i] + np.int32(first + second))


@njit(cache=True, nogil=True)
def _sum_disk(ring: Any, y: int, widths: Any, middle: int, total: Any) -> None:
    """The flat disk about row `y`; total[0] is centred on column `middle` of the running sums."""
    window, n = len(ring), total.size
    left, right = 3 * (middle - widths), 3 * (middle + widths + 1)
    row = ring[y % window]
    total[:] = 0
    _add_segment(total, row[right[0] : right[0] + n], row[left[0] : left[0] + n])
    dy = 1
    while dy + 1 < len(widths):
        a, b = ring[(y - dy) % window], ring[(y + dy) % window]
        c, d = ring[(y - dy - 1) % window], ring[(y + dy + 1) % window]
        l0, r0, l1, r1 = left[dy], right[dy], left[dy + 1], right[dy + 1]
        _add_four_segments(
            total,
            a[r0 : r0 + n],
            a[l0 : l0 + n],
            b[r0 : r0 + n],
            b[l0 : l0 + n],
            c[r1 : r1 + n],
            c[l1 : l1 + n],
            d[r1 : r1 + n],
            d[l1 : l1 + n],
        )
        dy += 2
    if dy < len(widths):
        l0, r0 = left[dy], right[dy]
        for row in (ring[(y - dy) % window], ring[(y + dy) % window]):
            _add_segment(total, row[r0 : r0 + n], row[l0 : l0 + n])


@njit(cache=True, nogil=True)
def _add_rim(total: Any, weight: Any, r0: Any, l0: Any, r1: Any, l1: Any, r2: Any, l2: Any, r3: Any, l3: Any) -> None:
    for i in range(total.size):
        inside = np.int32(np.int32(r0[i] - l0[i]) + np.int32(r1[i] - l1[i]))
        outside = np.int32(np.int32(r2[i] - l2[i]) + np.int32(r3[i] - l3[i]))
        total[i] += weight * np.float32(np.int32(inside - outside))


@njit(cache=True, nogil=True)
def _add_rim_rows(ring: Any, y: int, rim: Any, weights: Any, middle: int, total: Any) -> None:
    window, n = len(ring), total.size
    for k in range(len(rim)):
        d, h, e, g = rim[k]
        a, b = ring[(y - d) % window], ring[(y + d) % window]
        p, q = ring[(y - e) % window], ring[(y + e) % window]
        left, right = 3 * (middle - h), 3 * (middle + h + 1)
        first, last = 3 * (middle - g), 3 * (middle + g + 1)
        if g < 0:
            first = last
        _add_rim(
            total,
            weights[k],
            a[right : right + n],
            a[left : left + n],
            b[right : right + n],
            b[left : left + n],
            p[last : last + n],
            p[first : first + n],
            q[last : last + n],
            q[first : first + n],
        )


@njit(cache=True, nogil=True)
def _add_three(a: Any, b: Any, c: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = np.int32(a[i] + np.int32(b[i] + c[i]))


@njit(cache=True, nogil=True)
def _add_rim_columns(ring: Any, y: int, rim: Any, weights: Any, middle: int, columns: Any, total: Any) -> None:
    """`columns[h]` is room for the running sums of the rows y - h, ..., y + h together; `columns[-1]` stays zero."""
    window, n = len(ring), total.size
    row, first_sums = ring[y % window], columns[0]
    for i in range(row.size):  # an assignment of slices would compile its error messages, for three seconds
        first_sums[i] = row[i]
    for h in range(1, len(columns) - 1):
        _add_three(columns[h - 1], ring[(y - h) % window], ring[(y + h) % window], columns[h])
    for k in range(len(rim)):
        d, h, e, g = rim[k]
        a, b = columns[h], columns[g]
        left, right = 3 * (middle - d), 3 * (middle + d)
        first, last = 3 * (middle - e), 3 * (middle + e)
        _add_rim(
            total,
            weights[k],
            a[left + 3 : left + 3 + n],
            a[left : left + n],
            a[right + 3 : right + 3 + n],
            a[right : right + n],
            b[first + 3 : first + 3 + n],
            b[first : first + n],
            b[last + 3 : last + 3 + n],
            b[last : last + n],
        )


@njit(cache=True, nogil=True)
def _weigh(rows: Any, y: int, taps: Any, out: Any) -> None:
    """Blur down: `taps` on rows y - g, ..., y + g of a ring."""
    window = len(rows)
    row = rows[y % window]
    for i in range(out.size):
        out[i] = taps[0] * np.float32(row[i])
    for j in range(1, len(taps)):
        a, b = rows[(y - j) % window], rows[(y + j) % window]
        for i in range(out.size):
            out[i] += taps[j] * (np.float32(a[i]) + np.float32(b[i]))


@njit(cache=True, nogil=True)
def _convolve(
    source: Any,
    x0: int,
    widths: Any,
    taps: Any,
    rim: Any,
    rim_weights: Any,
    tallest: int,
    offset: Any,
    out: Any,
) -> None:
    """The strip of columns that `out` is, from column `x0` of `source` on; the rim needs `tallest` rows of sums."""
    height, n = out.shape
    g = len(taps) - 1
    reach = len(widths) - 1 + g
    window = 2 * reach + 1
    sums = np.empty((window, n + 3 * window), np.int32)
    disks = np.empty((2 * g + 1, n + 6 * g), np.int32)
    columns = np.zeros((tallest, sums.shape[1]), np.int32)
    sides = np.zeros((2 * g + 1, n), np.float32)
    down = np.empty(n + 6 * g, np.float32)
    total = np.empty(n, np.float32)
    for y in range(-reach, reach - 2 * g):
        _running_sums(source[mirrored(y, height)], x0 - reach, sums[y % window])
    for y in range(-2 * g, height):
        ahead = y + g
        _running_sums(source[mirrored(y + reach, height)], x0 - reach, sums[(y + reach) % window])
        _sum_disk(sums, ahead, widths, reach - g, disks[ahead % len(disks)])
        if len(rim) > 0:
            side = sides[ahead % len(sides)]
            side[:] = 0
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
        row = out[y]
        for i in range(n):
            row[i] = np.uint8(np.rint(min(max(total[i] + offset, np.float32(0)), np.float32(255))))
