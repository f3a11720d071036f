"""Blur along a straight line with a sparse kernel that has one tap per pixel on the line.

The taps are points on the line, rounded to pixels as in the reference code. Their weights are one half of a Gaussian
that starts at the pixel itself, so the kernel is one-sided. Edge pixels are repeated beyond the border.

Weights are 16-bit integers and pixels are 16-bit fractions, so the sum is identical on every machine. Truncation
reduces each tap by less than 1/256 of a grey level, and the mean loss is added back.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...compiled import inner, njit
from ...images.contiguous import contiguous
from ...sample import Frame


class LineKernel(NamedTuple):
    """A sparse kernel: out[y, x] = sum of weights[i] * in[y + offsets[i, 0], x + offsets[i, 1]]."""

    offsets: npt.NDArray[np.int64]
    """Offsets (dy, dx) in pixels, int64 (n, 2)."""
    weights: npt.NDArray[np.uint16]
    """Weights in units of 2**-16, uint16 (n,); their sum is 65535."""


def line_kernel(radius: int, sigma: float, angle: float) -> LineKernel:
    """Return the 2 * radius + 1 taps that start at the pixel, in direction `angle` (degrees; 0 is right, 90 is down).

    >>> kernel = line_kernel(2, 1.0, -90.0)
    >>> kernel.offsets.tolist(), int(kernel.weights.sum())
    ([[0, 0], [-1, 0], [-2, 0], [-3, 0], [-4, 0]], 65535)
    """
    steps = np.arange(2 * radius + 1)
    down, right = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    # points halfway between two pixels are rounded down; the offset hides differences in the last bit of sin and cos
    offsets = np.ceil(steps[:, None] * np.array([down, right]) - 0.5 - 1e-9).astype(np.int64)
    profile = np.exp(-(steps**2) / (2 * sigma**2))
    # differences of rounded running sums, so each weight and the total are accurate to one unit
    running = np.rint(np.cumsum(profile) / profile.sum() * 65535)
    return LineKernel(offsets, np.diff(running, prepend=0).astype(np.uint16))


def move_frame(frame: Frame, kernel: LineKernel) -> Frame:
    """Blur an image, uint8 (H, W, C), along a line; return a new uint8 array, rounded once."""
    height, width, channels = frame.shape
    rows = contiguous(frame).reshape(height, width * channels)
    return _moved(np.left_shift(rows, 8, dtype=np.uint16), channels, kernel).reshape(frame.shape)


def move_plane(plane: npt.NDArray[np.uint16], kernel: LineKernel) -> npt.NDArray[np.uint8]:
    """Blur one channel along a line: uint16 (H, W) in 1/256 grey levels, at most 65280; return uint8 (H, W)."""
    return _moved(np.ascontiguousarray(plane), 1, kernel)


def _moved(rows: npt.NDArray[np.uint16], step: int, kernel: LineKernel) -> npt.NDArray[np.uint8]:
    """Blur rows of pixels in 1/256 grey levels; horizontal neighbours within a channel are `step` values apart."""
    out = np.empty(rows.shape, np.uint8)
    _move(rows, step, kernel.offsets, *_extent(kernel), kernel.weights, out)
    return out


def _extent(kernel: LineKernel) -> tuple[int, int, int, int]:
    """Return the extent of the taps upwards and to the left (0 or negative), and downwards and to the right."""
    (up, left), (down, right) = kernel.offsets.min(axis=0).tolist(), kernel.offsets.max(axis=0).tolist()
    return min(0, up), max(0, down), min(0, left), max(0, right)


@inner
def _pad(row: Any, step: int, before: int, out: Any) -> None:
    """Pad a row by repeating its edge pixels on both sides."""
    n = row.size
    for i in range(before):
        out[i] = row[i % step]
    middle = out[before : before + n]
    for i in range(n):
        middle[i] = row[i]
    for i in range(out.size - before - n):
        out[before + n + i] = row[n - step + i % step]


@inner
def _add_tap(total: Any, a: Any, w: Any) -> None:
    for i in range(total.size):
        total[i] = np.uint16(total[i] + np.uint16(np.uint32(np.uint32(a[i]) * np.uint32(w)) >> 16))


@inner
def _add_four_taps(total: Any, a: Any, b: Any, c: Any, d: Any, w: Any) -> None:
    w0, w1, w2, w3 = np.uint32(w[0]), np.uint32(w[1]), np.uint32(w[2]), np.uint32(w[3])
    for i in range(total.size):
        first = np.uint16((np.uint32(a[i]) * w0) >> 16)
        second = np.uint16((np.uint32(b[i]) * w1) >> 16)
        third = np.uint16((np.uint32(c[i]) * w2) >> 16)
        fourth = np.uint16((np.uint32(d[i]) * w3) >> 16)
        total[i] = np.uint16(total[i] + first + second + third + fourth)


@njit(cache=True, nogil=True)
def _move(
    source: Any,
    step: int,
    offsets: Any,
    top: int,
    bottom: int,
    left: int,
    right: int,
    weights: Any,
    out: Any,
) -> None:
    height, n = source.shape
    taps = len(weights)
    before, after = -left * step, right * step
    window, length = bottom - top + 1, before + n + after
    rows = np.empty(window * length, np.uint16)
    starts = np.empty(taps, np.int64)
    total = np.empty(n, np.uint16)
    for y in range(top, bottom):
        begin = (y % window) * length
        _pad(source[min(max(y, 0), height - 1)], step, before, rows[begin : begin + length])
    bias = np.uint16(128 + taps // 2)
    for y in range(height):
        begin = ((y + bottom) % window) * length
        _pad(source[min(max(y + bottom, 0), height - 1)], step, before, rows[begin : begin + length])
        for k in range(taps):
            starts[k] = ((y + offsets[k, 0]) % window) * length + before + offsets[k, 1] * step
        for i in range(n):
            total[i] = bias
        k = 0
        while k + 4 <= taps:
            _add_four_taps(
                total,
                rows[starts[k] : starts[k] + n],
                rows[starts[k + 1] : starts[k + 1] + n],
                rows[starts[k + 2] : starts[k + 2] + n],
                rows[starts[k + 3] : starts[k + 3] + n],
                weights[k : k + 4],
            )
            k += 4
        while k < taps:
            _add_tap(total, rows[starts[k] : starts[k] + n], weights[k])
            k += 1
        row = out[y]
        for i in range(n):
            row[i] = np.uint8(total[i] >> 8)
