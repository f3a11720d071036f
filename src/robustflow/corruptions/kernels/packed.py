"""Sum and average RGB colours packed into one word, with 20 bits per channel. Sums of up to 4096 values fit;
differences of longer running sums are exact even though the sums overflow.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compiled import inner, njit

FRACTION = 16
"""Fractional bits of positions."""
EIGHTHS = 8
"""Number of steps per pixel to which `between` rounds positions."""
LARGEST = 4096
"""Largest number of values in a sum."""
_ROUND = 1 << (FRACTION - 4)


@inner
def reciprocals() -> Any:
    """Return the reciprocals of 0 to `LARGEST` with 32 fractional bits, with which `divide` divides sums exactly."""
    out = np.zeros(LARGEST + 1, np.uint64)
    for k in range(1, out.size):
        out[k] = np.uint64((2**32 + k - 1) // k)
    return out


@njit(cache=True, nogil=True)
def pack(frame: Any, out: Any) -> None:
    """Pack the pixels of a frame, uint8 (H, W, 3), into words, uint64 (H * W,)."""
    pixels = frame.reshape(-1)
    for i in range(out.size):
        red, green, blue = np.uint64(pixels[3 * i]), np.uint64(pixels[3 * i + 1]), np.uint64(pixels[3 * i + 2])
        out[i] = red | (green << np.uint64(20)) | (blue << np.uint64(40))


@njit(cache=True, nogil=True, inline="always")
def until(sums: Any, row: Any, end: Any, bits: Any) -> Any:
    """Return the integral of a row up to position `end`, both in units of 2**-bits px; edge pixels are repeated."""
    i, last = end >> bits, np.int64(row.size - 1)
    inside = min(max(i, 0), last)
    return (sums[np.uint64(inside)] << np.uint64(bits)) + np.uint64(end - (inside << bits)) * row[np.uint64(inside)]


@njit(cache=True, nogil=True, inline="always")
def mean(front: Any, fronts: Any, back: Any, backs: Any, count: Any, out: Any) -> None:
    """Write the mean of `count` values, of which `fronts` have the sum `front`; each of the others counts as
    the mean of `backs` values with the sum `back`.
    """
    mask = np.uint64((1 << 20) - 1)
    number = count * backs
    part = 1.0 / np.float64(number)  # adding 1/2 to the numerator makes the rounded quotient exact
    for channel in range(3):
        place = np.uint64(20 * channel)
        first, second = np.int64((front >> place) & mask), np.int64((back >> place) & mask)
        total = first * backs + second * (count - fronts) + number // 2
        out[channel] = np.uint8(np.int64((np.float64(total) + 0.5) * part))


@njit(cache=True, nogil=True, inline="always")
def between(packed: Any, width: int, height: int, x: Any, y: Any) -> Any:
    """Interpolate the colour between four pixels in steps of 1/8 px, and return it multiplied by 64."""
    x, y = (x + _ROUND) >> (FRACTION - 3), (y + _ROUND) >> (FRACTION - 3)
    right, down = np.uint64(1), np.uint64(width)
    if not (0 <= x < EIGHTHS * (width - 1) and 0 <= y < EIGHTHS * (height - 1)):
        x, y = min(max(x, 0), EIGHTHS * (width - 1)), min(max(y, 0), EIGHTHS * (height - 1))
        right = np.uint64(x < EIGHTHS * (width - 1))
        down = np.uint64(width) * np.uint64(y < EIGHTHS * (height - 1))
    wx, wy = np.uint64(x & 7), np.uint64(y & 7)
    at = np.uint64((y >> 3) * width + (x >> 3))
    upper = packed[at] * (np.uint64(8) - wx) + packed[at + right] * wx
    at += down
    lower = packed[at] * (np.uint64(8) - wx) + packed[at + right] * wx
    return upper * (np.uint64(8) - wy) + lower * wy


@njit(cache=True, nogil=True, inline="always")
def divide(total: Any, count: Any, parts: Any, out: Any, at: Any) -> None:
    """Divide the three channels of a sum by `count`, with rounding; `parts` are the `reciprocals`."""
    mask, half, factor = np.uint64((1 << 20) - 1), np.uint64(count // 2), parts[count]
    out[at] = np.uint8((((total & mask) + half) * factor) >> np.uint64(32))
    out[at + 1] = np.uint8(((((total >> np.uint64(20)) & mask) + half) * factor) >> np.uint64(32))
    out[at + 2] = np.uint8((((total >> np.uint64(40)) + half) * factor) >> np.uint64(32))
