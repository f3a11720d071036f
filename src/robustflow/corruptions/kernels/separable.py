"""Filter with a Gaussian in strict float32, with identical bytes on every machine.

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

from ...compiled import inner, njit
from ...images.contiguous import contiguous
from ...sample import Frame

Plane = npt.NDArray[np.float32]
"""A channel, float32 (H, W)."""

FLOOR = -0.499
"""Value of `offset` that turns rounding into truncation, like a conversion to uint8. It is slightly above -0.5 so that
rounding errors of a few 1e-5 (e.g. 254.99998 in a white area) do not reduce the result by a grey level.
"""


@lru_cache(maxsize=64)
def gaussian_weights(sigma: float, truncate: float = 4.0) -> npt.NDArray[np.float32]:
    """Return one half of a normalised Gaussian kernel, starting at the centre.

    The result is float32 (r + 1,) with r = int(truncate * sigma + 0.5).

    >>> half = gaussian_weights(1.0)
    >>> len(half), round(float(half[0] + 2 * half[1:].sum()), 6)
    (5, 1.0)
    """
    radius = int(truncate * sigma + 0.5)
    half = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    half /= half[0] + 2.0 * half[1:].sum()
    weights = half.astype(np.float32)
    weights.flags.writeable = False
    return weights


def gaussian_frame(frame: Frame, sigma: float, offset: float = 0.0) -> Frame:
    """Blur an image and return a new uint8 array of the same shape, rounded once.

    Args:
        frame: image, uint8 (H, W, C).
        sigma: standard deviation in pixels.
        offset: offset in grey levels, added before rounding half to even; use `FLOOR` to truncate.
    """
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
    _blur_to_float(np.ascontiguousarray(rows, np.float32), step, gaussian_weights(sigma), out)
    return out


@inner
def _add_pair(total: Any, a: Any, b: Any, w: Any) -> None:
    for i in range(total.size):
        total[i] += w * (a[i] + b[i])


@inner
def _add_four_pairs(total: Any, a0: Any, b0: Any, a1: Any, b1: Any, a2: Any, b2: Any, a3: Any, b3: Any, w: Any) -> None:
    """Add four taps per pass over `total`, which requires a quarter of the loads and stores."""
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    for i in range(total.size):
        first = w0 * (a0[i] + b0[i]) + w1 * (a1[i] + b1[i])
        second = w2 * (a2[i] + b2[i]) + w3 * (a3[i] + b3[i])
        total[i] += first + second


@inner
def _down_columns(source: Any, y: int, weights: Any, out: Any) -> None:
    """Filter row `y` of `source` vertically into `out`."""
    last = source.shape[0] - 1
    row = source[y]
    w0 = weights[0]
    for i in range(out.size):
        out[i] = w0 * row[i]
    k = 1
    while k + 4 <= weights.size:
        _add_four_pairs(
            out,
            source[max(y - k, 0)],
            source[min(y + k, last)],
            source[max(y - k - 1, 0)],
            source[min(y + k + 1, last)],
            source[max(y - k - 2, 0)],
            source[min(y + k + 2, last)],
            source[max(y - k - 3, 0)],
            source[min(y + k + 3, last)],
            weights[k : k + 4],
        )
        k += 4
    while k < weights.size:
        _add_pair(out, source[max(y - k, 0)], source[min(y + k, last)], weights[k])
        k += 1


@inner
def _along_row(padded: Any, step: int, weights: Any, out: Any) -> None:
    """Filter a padded row.

    Neighbours within a channel are `step` values apart, and the padding is (weights.size - 1) * step values.
    """
    n = out.size
    middle = (weights.size - 1) * step
    row = padded[middle : middle + n]
    w0 = weights[0]
    for i in range(n):
        out[i] = w0 * row[i]
    k = 1
    while k + 4 <= weights.size:
        left, right = middle - k * step, middle + k * step
        _add_four_pairs(
            out,
            padded[left : left + n],
            padded[right : right + n],
            padded[left - step : left - step + n],
            padded[right + step : right + step + n],
            padded[left - 2 * step : left - 2 * step + n],
            padded[right + 2 * step : right + 2 * step + n],
            padded[left - 3 * step : left - 3 * step + n],
            padded[right + 3 * step : right + 3 * step + n],
            weights[k : k + 4],
        )
        k += 4
    while k < weights.size:
        left, right = middle - k * step, middle + k * step
        _add_pair(out, padded[left : left + n], padded[right : right + n], weights[k])
        k += 1


@inner
def _repeat_edges(padded: Any, step: int, pad: int) -> None:
    n = padded.size
    for i in range(pad):
        padded[i] = padded[pad + i % step]
        padded[n - pad + i] = padded[n - pad - step + i % step]


@njit(cache=True, nogil=True)
def _blur_to_float(source: Any, step: int, weights: Any, out: Any) -> None:
    height, n = source.shape
    pad = (weights.size - 1) * step
    padded = np.empty(n + 2 * pad, np.float32)
    for y in range(height):
        _down_columns(source, y, weights, padded[pad : pad + n])
        _repeat_edges(padded, step, pad)
        _along_row(padded, step, weights, out[y])


@njit(cache=True, nogil=True)
def _round(values: Any, offset: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = np.uint8(np.rint(min(max(values[i] + offset, np.float32(0)), np.float32(255))))
