"""Blur along a straight line with a sparse kernel that has one tap per pixel on the line.

The taps are points on the line, rounded to pixels as in the reference code. Their weights are one half of a Gaussian
that starts at the pixel itself, so the kernel is one-sided. Edge pixels are repeated beyond the border.

Weights are 16-bit integers and pixels are 16-bit fractions, so the sum is identical on every machine. Truncation
reduces each tap by less than 1/256 of a grey level, and the mean loss is added back.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.types import Frame


class LineKernel(NamedTuple):
    """A sparse kernel: out[y, x] = sum of weights[i] * in[y + offsets[i, 0], x + offsets[i, 1]]."""

    offsets: npt.NDArray[np.int64]  # offsets (dy, dx) in pixels, int64 (n, 2)
    weights: npt.NDArray[np.uint16]  # weights in units of 2**-16, uint16 (n,); their sum is 65535


def line_kernel(radius: int, sigma: float, angle: float) -> LineKernel:
    """Return the 2 * radius + 1 taps that start at the pixel, in direction `angle` (degrees; 0 is right, 90 is
    down).
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
    return _blurred(np.left_shift(frame, 8, dtype=np.uint16), kernel)


def move_plane(plane: npt.NDArray[np.uint16], kernel: LineKernel) -> npt.NDArray[np.uint8]:
    """Blur one channel along a line: uint16 (H, W) in 1/256 grey levels, at most 65280; return uint8 (H, W)."""
    return _blurred(plane, kernel)


def _blurred(image: npt.NDArray[np.uint16], kernel: LineKernel) -> npt.NDArray[np.uint8]:
    """Blur an image in 1/256 grey levels, uint16 (H, W) or (H, W, C)."""
    (up, left), (down, right) = np.minimum(kernel.offsets.min(axis=0), 0), np.maximum(kernel.offsets.max(axis=0), 0)
    padded = cv2.copyMakeBorder(np.ascontiguousarray(image), -up, down, -left, right, cv2.BORDER_REPLICATE)
    length, step = padded[0].size, padded[0, 0].size
    starts = (kernel.offsets[:, 0] - up) * length + (kernel.offsets[:, 1] - left) * step
    out = np.empty((len(image), image[0].size), np.uint8)
    _move(padded.reshape(-1), length, starts.astype(np.uint64), kernel.weights, np.empty(out.shape[1], np.uint16), out)
    return out.reshape(image.shape)


@njit(cache=True, nogil=True)
def _move(padded: Any, length: int, starts: Any, weights: Any, total: Any, out: Any) -> None:
    """Sum the taps; tap k of row y begins at `padded[y * length + starts[k]]`."""
    n, taps = np.uint64(total.size), len(weights)
    bias = np.uint16(128 + taps // 2)
    for y in range(out.shape[0]):
        row, k = np.uint64(y * length), 0
        for i in range(n):
            total[i] = bias
        while k + 4 <= taps:
            a, b, c, d = row + starts[k], row + starts[k + 1], row + starts[k + 2], row + starts[k + 3]
            wa, wb = np.uint32(weights[k]), np.uint32(weights[k + 1])
            wc, wd = np.uint32(weights[k + 2]), np.uint32(weights[k + 3])
            for i in range(n):
                first = np.uint16((np.uint32(padded[a + i]) * wa) >> 16)
                second = np.uint16((np.uint32(padded[b + i]) * wb) >> 16)
                third = np.uint16((np.uint32(padded[c + i]) * wc) >> 16)
                fourth = np.uint16((np.uint32(padded[d + i]) * wd) >> 16)
                total[i] = np.uint16(total[i] + first + second + third + fourth)
            k += 4
        while k < taps:
            a, wa = row + starts[k], np.uint32(weights[k])
            for i in range(n):
                total[i] = np.uint16(total[i] + np.uint16(np.uint32(np.uint32(padded[a + i]) * wa) >> 16))
            k += 1
        for i in range(n):
            out[y, i] = np.uint8(total[i] >> 8)
