"""Borders, rounding to bytes, and a Gaussian filter in strict float32, with identical bytes on every machine.

SciPy's filter processes entire images in float64. OpenCV's uint8 version takes 0.7 times as long, but uses 8-bit
coefficients (errors of up to two grey levels); its float version takes longer, and its result depends on the processor.
Here, every output row is filtered vertically from the source and then horizontally, with additions in a fixed order, so
no intermediate image is needed, and the row stays in the cache. As in scikit-image's `gaussian`, edge pixels are
repeated beyond the border (`nearest`), and the kernel is cut off at four standard deviations.
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


_BAND = 64
"""Number of rows of an image that are blurred together, so that their float32 values stay in the cache."""


def gaussian_frame(frame: Frame, sigma: float, offset: float = 0.0) -> Frame:
    """Blur an image and return a new uint8 array of the same shape, rounded once."""
    height, width, channels = frame.shape
    rows, out = contiguous(frame).reshape(height, width * channels), np.empty(frame.shape, np.uint8)
    for top in range(0, height, _BAND):
        band = _blurred(rows, channels, sigma, top, min(top + _BAND, height))
        _round(band.reshape(-1), np.float32(offset), out[top : top + len(band)].reshape(-1))
    return out


def gaussian_plane(plane: npt.NDArray[Any], sigma: float) -> Plane:
    """Blur one channel, uint8, int16 or float32 (H, W), and return it as float32 (H, W), unrounded."""
    return _blurred(plane, 1, sigma, 0, len(plane))


def _blurred(rows: npt.NDArray[Any], step: int, sigma: float, top: int, bottom: int) -> Plane:
    """Return the blurred rows from `top` to `bottom`; horizontal neighbours within a channel are `step` values
    apart."""
    height, n = rows.shape
    weights = gaussian_weights(sigma)
    taps, lines = np.arange(len(weights)), np.arange(top, bottom)[:, None]
    first, pad = max(top - len(weights) + 1, 0), (len(weights) - 1) * step
    vertical = (np.stack([np.maximum(lines - taps, 0), np.minimum(lines + taps, height - 1)]) - first) * n
    horizontal = np.stack([pad - taps * step, pad + taps * step])
    padded, out = np.empty(n + 2 * pad, np.float32), np.empty((bottom - top, n), np.float32)
    # Always use float32 and pass the step as an argument, so that the loops are compiled only once.
    source = np.ascontiguousarray(rows[first : bottom + len(weights) - 1], np.float32).reshape(-1)
    starts = vertical.astype(np.uint64), horizontal.astype(np.uint64)[:, None]
    _blur_to_float(source, step, weights, *starts, padded, padded[pad : pad + n], out)
    return out


@inner
def _weigh(values: Any, starts: Any, y: Any, weights: Any, out: Any) -> None:
    """Compute the sum over k of weights[k] * (values[starts[0, y, k] + i] + values[starts[1, y, k] + i]), with one
    value for k = 0. Four taps per pass over `out` require a quarter of the loads and stores.
    """
    n, taps = np.uint64(out.size), weights.size
    a0, w0 = starts[0, y, 0], weights[0]
    for i in range(n):
        out[i] = w0 * values[a0 + i]
    k = 1
    while k + 4 <= taps:
        a0, a1, a2, a3 = starts[0, y, k], starts[0, y, k + 1], starts[0, y, k + 2], starts[0, y, k + 3]
        b0, b1, b2, b3 = starts[1, y, k], starts[1, y, k + 1], starts[1, y, k + 2], starts[1, y, k + 3]
        w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        for i in range(n):
            first = w0 * (values[a0 + i] + values[b0 + i]) + w1 * (values[a1 + i] + values[b1 + i])
            second = w2 * (values[a2 + i] + values[b2 + i]) + w3 * (values[a3 + i] + values[b3 + i])
            out[i] += first + second
        k += 4
    while k < taps:
        a0, b0, w0 = starts[0, y, k], starts[1, y, k], weights[k]
        for i in range(n):
            out[i] += w0 * (values[a0 + i] + values[b0 + i])
        k += 1


@njit(cache=True, nogil=True)
def _blur_to_float(
    source: Any, step: int, weights: Any, vertical: Any, horizontal: Any, padded: Any, middle: Any, out: Any
) -> None:
    """Filter each row of a flattened image vertically into the middle of a padded row, and then horizontally."""
    n = padded.size
    pad = (n - middle.size) // 2
    for y in range(out.shape[0]):
        _weigh(source, vertical, y, weights, middle)
        for i in range(pad):
            padded[i] = padded[pad + i % step]
            padded[n - pad + i] = padded[n - pad - step + i % step]
        _weigh(padded, horizontal, 0, weights, out[y])


@njit(cache=True, nogil=True)
def _round(values: Any, offset: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = np.uint8(np.rint(min(max(values[i] + offset, np.float32(0)), np.float32(255))))
