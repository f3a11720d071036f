"""Borders, rounding to bytes, and a Gaussian filter in strict float32, with identical bytes on every machine.

SciPy's filter processes entire images in float64. OpenCV's uint8 version uses 8-bit coefficients (errors of up to two
grey levels), and the result of its float version depends on the processor. Here, every output row is filtered
vertically from the source and then horizontally, with additions in a fixed order, so no intermediate image is needed,
and the row stays in the cache. As in scikit-image's `gaussian`, edge pixels are repeated beyond the border (`nearest`),
and the kernel is cut off at four standard deviations.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, inner, njit
from ...core.types import Frame


@njit(cache=True, nogil=True)
def mirrored(i: int, n: int) -> int:
    """Mirror index `i` on an axis of length `n` at the end pixels, without repeating them."""
    if n == 1:
        return 0
    i = i % (2 * n - 2)
    return min(i, 2 * n - 2 - i)


@inner
def mirrored_with_edge(i: int, n: int) -> int:
    """Mirror index `i` on an axis of length `n`, repeating the end pixels.

    >>> [mirrored_with_edge(i, 3) for i in range(-3, 6)]
    [2, 1, 0, 0, 1, 2, 2, 1, 0]
    """
    i = i % (2 * n)
    return min(i, 2 * n - 1 - i)


def to_bytes(levels: npt.NDArray[np.floating[Any]], floor: bool = False) -> npt.NDArray[np.uint8]:
    """Clip to the range 0 to 255 and round half to even; with `floor`, truncate as some parts of the reference code
    do.
    """
    clipped = np.clip(levels, 0.0, 255.0)
    return (np.floor(clipped) if floor else np.rint(clipped)).astype(np.uint8)


Plane = npt.NDArray[np.float32]
"""A channel, float32 (H, W)."""

FLOOR = -0.499
"""Value of `offset` that turns rounding into truncation, like a conversion to uint8. It is slightly above -0.5 so that
rounding errors of a few 1e-5 (e.g. 254.99998 in a white area) do not reduce the result by a grey level.
"""


@lru_cache(maxsize=64)
def gaussian_weights(sigma: float) -> npt.NDArray[np.float32]:
    """Return one half of a normalised Gaussian kernel, starting at the centre.

    >>> half = gaussian_weights(1.0)
    >>> len(half), round(float(half[0] + 2 * half[1:].sum()), 6)
    (5, 1.0)
    """
    radius = int(4.0 * sigma + 0.5)
    half = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    half /= half[0] + 2.0 * half[1:].sum()
    weights = half.astype(np.float32)
    weights.flags.writeable = False
    return weights


def gaussian_frame(frame: Frame, sigma: float, offset: float = 0.0) -> Frame:
    """Blur an image and return a new uint8 array of the same shape, rounded once."""
    height, width, channels = frame.shape
    blurred = _blurred(contiguous(frame).reshape(height, width * channels), channels, sigma)
    out = np.empty(frame.shape, np.uint8)
    _round(blurred.reshape(-1), np.float32(offset), out.reshape(-1))
    return out


def gaussian_plane(plane: npt.NDArray[Any], sigma: float) -> Plane:
    """Blur one channel, uint8, int16 or float32 (H, W), and return it as float32 (H, W), unrounded."""
    return _blurred(plane, 1, sigma)


def _blurred(rows: npt.NDArray[Any], step: int, sigma: float) -> Plane:
    """Blur rows of pixels; horizontal neighbours within a channel are `step` values apart."""
    out = np.empty(rows.shape, np.float32)
    # Always use float32 and pass the step as an argument, so that the loops are compiled only once.
    source = np.ascontiguousarray(rows, np.float32).reshape(-1)
    _blur_to_float(source, len(rows), step, gaussian_weights(sigma), out.reshape(-1))
    return out


@inner
def _add_pair(values: Any, left: int, right: int, w: Any, total: Any) -> None:
    a, b = values[left : left + total.size], values[right : right + total.size]
    for i in range(total.size):
        total[i] += w * (a[i] + b[i])


@inner
def _add_four_pairs(values: Any, left: Any, right: Any, w: Any, total: Any) -> None:
    """Add four taps per pass over `total`, which requires a quarter of the loads and stores."""
    n, w0, w1, w2, w3 = total.size, w[0], w[1], w[2], w[3]
    a0, b0 = values[left[0] : left[0] + n], values[right[0] : right[0] + n]
    a1, b1 = values[left[1] : left[1] + n], values[right[1] : right[1] + n]
    a2, b2 = values[left[2] : left[2] + n], values[right[2] : right[2] + n]
    a3, b3 = values[left[3] : left[3] + n], values[right[3] : right[3] + n]
    for i in range(n):
        first = w0 * (a0[i] + b0[i]) + w1 * (a1[i] + b1[i])
        second = w2 * (a2[i] + b2[i]) + w3 * (a3[i] + b3[i])
        total[i] += first + second


@inner
def _weigh(values: Any, centre: int, left: Any, right: Any, weights: Any, out: Any) -> None:
    """Compute weights[0] * values[centre + i] + sum of weights[k] * (values[left[k] + i] + values[right[k] + i])."""
    n = out.size
    row = values[centre : centre + n]
    w0 = weights[0]
    for i in range(n):
        out[i] = w0 * row[i]
    k = 1
    while k + 4 <= weights.size:
        _add_four_pairs(values, left[k : k + 4], right[k : k + 4], weights[k : k + 4], out)
        k += 4
    while k < weights.size:
        _add_pair(values, left[k], right[k], weights[k], out)
        k += 1


@inner
def _repeat_edges(padded: Any, step: int, pad: int) -> None:
    n = padded.size
    for i in range(pad):
        padded[i] = padded[pad + i % step]
        padded[n - pad + i] = padded[n - pad - step + i % step]


@njit(cache=True, nogil=True)
def _blur_to_float(source: Any, height: int, step: int, weights: Any, out: Any) -> None:
    """Filter each row of a flattened image vertically into a padded row, and then horizontally."""
    n, taps = source.size // height, weights.size
    pad = (taps - 1) * step
    padded = np.empty(n + 2 * pad, np.float32)
    above, below = np.empty(taps, np.int64), np.empty(taps, np.int64)
    left, right = np.empty(taps, np.int64), np.empty(taps, np.int64)
    for k in range(taps):
        left[k], right[k] = pad - k * step, pad + k * step
    for y in range(height):
        for k in range(taps):
            above[k], below[k] = max(y - k, 0) * n, min(y + k, height - 1) * n
        _weigh(source, y * n, above, below, weights, padded[pad : pad + n])
        _repeat_edges(padded, step, pad)
        _weigh(padded, pad, left, right, weights, out[y * n : y * n + n])


@njit(cache=True, nogil=True)
def _round(values: Any, offset: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = np.uint8(np.rint(min(max(values[i] + offset, np.float32(0)), np.float32(255))))
