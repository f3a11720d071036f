"""Convolution with an anti-aliased disk in a time that grows with its radius, not its area.

The kernel is a flat disk blurred by a tiny Gaussian g (3 or 5 taps), so the image is first summed over the flat disk,
exactly, as differences of integer running sums along the rows, and the sum is blurred by g down and along.

Where the disk touches the edge of the array the reference code blurs it in (radius 8 and 10), mirroring moves what g
would spread outside back inside. In each direction that adds a few segments of the disk's outermost rows (columns):
`_mirrored_rim` lists them, and they are added as rows before, and as columns after, the blur along the row.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from ...sample import Frame
from ..separable import FLOOR

_NEGLIGIBLE = 1e-9
"""Taps of g below this are zero: at a smoothing of 0.1 they are 1e-22."""

_ROOM = 8
"""The array reaches this far from its centre, or as far as the disk if that is farther."""

_STRIP = 640
"""Columns worked on at a time: few enough for the rows that a sum reads to stay in the first-level cache."""


class _Disk(NamedTuple):
    widths: npt.NDArray[np.int64]
    """Half-width of row dy of the disk, int64 (radius + 1,)."""
    taps: npt.NDArray[np.float32]
    """Half of g, centre first, float32 (g + 1,), divided by the square root of the disk's area."""
    rim: npt.NDArray[np.int64]
    """int64 (n, 2): (distance d, half-width h) of the mirrored segments."""
    rim_weights: npt.NDArray[np.float32]
    """Their weights, float32 (n,), in the units of `taps`."""


def convolve_disk(frame: Frame, radius: int, smoothing: float, floor: bool = False) -> Frame:
    """The frame convolved with `disk_kernel(radius, smoothing)`: uint8 (H, W, 3) in and out, borders mirrored.

    Rounds once, or cuts the fraction off with `floor`.
    """
    height, width = frame.shape[:2]
    source = np.ascontiguousarray(frame).reshape(height, width * 3)
    out = np.empty_like(source)
    offset = np.float32(FLOOR if floor else 0)
    for x in range(0, width, _STRIP):
        _convolve(source, x, *_disk(radius, smoothing), offset, out[:, 3 * x : 3 * (x + _STRIP)])
    return out.reshape(frame.shape)


def disk_kernel(radius: int, smoothing: float) -> npt.NDArray[np.float64]:
    """The kernel itself, float64 (n, n): n = 17 up to radius 8, else 2 * radius + 1.

    >>> [round(float(disk_kernel(r, 0.5).sum()), 3) for r in (6, 8, 10)]
    [1.0, 1.013, 1.011]
    """
    axis = np.arange(-max(radius, _ROOM), max(radius, _ROOM) + 1)
    disk = (axis[:, None] ** 2 + axis[None, :] ** 2 <= radius**2).astype(np.float64)
    taps = _smoothing_taps(radius, smoothing)
    taps = np.concatenate([taps[:0:-1], taps])
    padded = np.pad(disk / disk.sum(), len(taps) // 2, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (len(taps), len(taps)))
    return np.einsum("yxij,i,j->yx", windows, taps, taps)


def _smoothing_taps(radius: int, smoothing: float) -> npt.NDArray[np.float64]:
    """Half of g, centre first; only the centre where there is no smoothing."""
    if smoothing == 0:
        return np.ones(1)
    half = np.exp(-0.5 * (np.arange(2 if radius <= _ROOM else 3) / smoothing) ** 2)
    half /= half[0] + 2 * half[1:].sum()
    return half[half > _NEGLIGIBLE]


@lru_cache(maxsize=16)
def _disk(radius: int, smoothing: float) -> _Disk:
    widths = np.array([isqrt(radius**2 - dy**2) for dy in range(radius + 1)])
    taps = _smoothing_taps(radius, smoothing)
    area = int((2 * widths + 1).sum() * 2 - (2 * widths[0] + 1))
    scale = area**-0.5
    rim = _mirrored_rim(radius, taps)
    rows = np.array([(d, widths[row]) for d, row, _ in rim], np.int64).reshape(-1, 2)
    # a rim segment is weighted once by g's tap and once more by the blur across it
    weights = np.array([weight * scale for *_, weight in rim], np.float32)
    return _Disk(widths, (taps * scale).astype(np.float32), rows, weights)


def _mirrored_rim(radius: int, taps: npt.NDArray[np.float64]) -> list[tuple[int, int, float]]:
    """(distance d, row of the disk, weight): what mirroring adds to, and takes from, the blurred disk.

    Narrowest rows first.
    """
    edge, reach = max(radius, _ROOM), len(taps) - 1
    pairs = [(over, j) for over in range(1, reach + 1) for j in range(over, reach + 1)]
    inside = [(edge + over - j, edge - over, float(taps[j])) for over, j in pairs]
    outside = [(edge + over, edge + over - j, -float(taps[j])) for over, j in pairs]
    return sorted((s for s in inside + outside if s[1] <= radius), key=lambda s: -s[1])


@njit(cache=True, nogil=True)
def _mirror(i: int, n: int) -> int:
    """Index `i` of an axis of length `n` mirrored about its end pixels, without repeating them."""
    if n == 1:
        return 0
    period = 2 * n - 2
    i = i % period
    return min(i, period - i)


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
        at = 3 * x if 0 <= x < width else 3 * _mirror(x, width)
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
def _add_rim(total: Any, r0: Any, l0: Any, r1: Any, l1: Any, weight: Any) -> None:
    for i in range(total.size):
        total[i] += weight * np.float32(np.int32(r0[i] - l0[i]) + np.int32(r1[i] - l1[i]))


@njit(cache=True, nogil=True)
def _add_rim_rows(ring: Any, y: int, rim: Any, weights: Any, middle: int, total: Any) -> None:
    window, n = len(ring), total.size
    for k in range(len(rim)):
        d, h = rim[k]
        a, b = ring[(y - d) % window], ring[(y + d) % window]
        left, right = 3 * (middle - h), 3 * (middle + h + 1)
        _add_rim(total, a[right : right + n], a[left : left + n], b[right : right + n], b[left : left + n], weights[k])


@njit(cache=True, nogil=True)
def _add_rim_columns(ring: Any, y: int, rim: Any, weights: Any, middle: int, column: Any, total: Any) -> None:
    window, n = len(ring), total.size
    column[:] = ring[y % window]
    summed = 0
    for k in range(len(rim)):
        d, h = rim[k]
        while summed < h:
            summed += 1
            a, b = ring[(y - summed) % window], ring[(y + summed) % window]
            for i in range(column.size):
                column[i] = np.int32(column[i] + np.int32(a[i] + b[i]))
        left, right = 3 * (middle - d), 3 * (middle + d)
        _add_rim(
            total,
            column[left + 3 : left + 3 + n],
            column[left : left + n],
            column[right + 3 : right + 3 + n],
            column[right : right + n],
            weights[k],
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
def _convolve(source: Any, x0: int, widths: Any, taps: Any, rim: Any, rim_weights: Any, offset: Any, out: Any) -> None:
    """The strip of columns that `out` is, from column `x0` of `source` on."""
    height, n = out.shape
    g = len(taps) - 1
    reach = len(widths) - 1 + g
    window = 2 * reach + 1
    sums = np.empty((window, n + 3 * window), np.int32)
    disks = np.empty((2 * g + 1, n + 6 * g), np.int32)
    column = np.empty(sums.shape[1], np.int32)
    columns = np.zeros((2 * g + 1, n), np.float32)
    down = np.empty(n + 6 * g, np.float32)
    total = np.empty(n, np.float32)
    for y in range(-reach, reach - 2 * g):
        _running_sums(source[_mirror(y, height)], x0 - reach, sums[y % window])
    for y in range(-2 * g, height):
        ahead = y + g
        _running_sums(source[_mirror(y + reach, height)], x0 - reach, sums[(y + reach) % window])
        _sum_disk(sums, ahead, widths, reach - g, disks[ahead % len(disks)])
        if len(rim) > 0:
            columns[ahead % len(columns)] = 0
            _add_rim_columns(sums, ahead, rim, rim_weights, reach, column, columns[ahead % len(columns)])
        if y < 0:
            continue
        _weigh(disks, y, taps, down)
        _add_rim_rows(sums, y, rim, rim_weights, reach - g, down)
        _weigh(columns, y, taps, total)
        for j in range(g + 1):
            a, b = down[3 * (g - j) : 3 * (g - j) + n], down[3 * (g + j) : 3 * (g + j) + n]
            tap = taps[j] if j > 0 else taps[j] * np.float32(0.5)
            for i in range(n):
                total[i] += tap * (a[i] + b[i])
        row = out[y]
        for i in range(n):
            row[i] = np.uint8(np.rint(min(max(total[i] + offset, np.float32(0)), np.float32(255))))
