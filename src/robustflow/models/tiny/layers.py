"""The layers of the small network in NumPy and compiled loops, and its sizes. Maps are float32 (H, W, C)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from ...core.compiled import njit

Maps = npt.NDArray[np.float32]
Weights = npt.NDArray[np.float32]

_STRIP = 2048
"""Number of output pixels that are computed at a time, chosen to fit into a core's cache at any frame size."""
_SLOPE = np.float32(0.1)


def convolve(
    maps: Maps, weight: Weights, bias: Weights, stride: int = 1, dilation: int = 1, linear: bool = False
) -> Maps:
    """Apply a convolution that keeps the size (up to its stride), then LeakyReLU(0.1) unless `linear`."""
    from scipy.linalg.blas import sgemm  # imported here because only this network needs the import of 0.1 s

    height, width, channels = maps.shape
    outputs, _, kernel, _ = weight.shape
    high, wide = -(-height // stride), -(-width // stride)
    reach = (kernel - 1) // 2 * dilation
    rows, columns = (side - (-2 * reach // stride) for side in (high + 1, wide))  # the last taps read into the next row
    padded = np.zeros((rows * stride, columns * stride, channels), np.float32)
    padded[reach : reach + height, reach : reach + width] = maps
    phases = padded.reshape(rows, stride, columns, stride, channels).transpose(1, 3, 0, 2, 4)
    phases = phases.reshape(stride, stride, rows * columns, channels)
    taps = []
    for y, x in np.ndindex(kernel, kernel):
        (down, row), (right, column) = divmod(y * dilation, stride), divmod(x * dilation, stride)
        taps.append((phases[row, column].T, down * columns + right, weight[:, :, y, x]))
    out = np.empty((high * columns, outputs), np.float32)
    for first in range(0, len(out), _STRIP):
        strip = out[first : first + _STRIP]
        strip[:] = bias
        for pixels, shift, matrix in taps:
            start = first + shift
            sgemm(1.0, matrix, pixels[:, start : start + len(strip)], beta=1.0, c=strip.T, overwrite_c=1)
        if not linear:
            np.maximum(strip, _SLOPE * strip, out=strip)
    return out.reshape(high, columns, outputs)[:, :wide]


def normalised(maps: Maps, epsilon: float) -> Maps:
    """Normalise features to a mean square of 1 over the channels."""
    mean = np.einsum("hwc,hwc->hw", maps, maps) / np.float32(maps.shape[2])
    return maps * (np.float32(1.0) / np.sqrt(mean + np.float32(epsilon)))[..., None]


def resized(flow: Maps, height: int, width: int) -> Maps:
    """Resize a flow (h, w, 2) bilinearly with aligned corner pixels, and scale its values."""
    high, wide, _ = flow.shape
    y = np.linspace(0, high - 1, height, dtype=np.float64)
    x = np.linspace(0, wide - 1, width, dtype=np.float64)
    rows, columns = (np.minimum(np.floor(at).astype(int), max(side - 2, 0)) for at, side in ((y, high), (x, wide)))
    v, u = (y - rows).astype(np.float32)[:, None, None], (x - columns).astype(np.float32)[:, None]
    below, right = np.minimum(rows + 1, high - 1), np.minimum(columns + 1, wide - 1)
    upper = flow[rows][:, columns] * (1 - u) + flow[rows][:, right] * u
    lower = flow[below][:, columns] * (1 - u) + flow[below][:, right] * u
    ratios = np.array([width / wide, height / high], np.float32)
    return np.asarray((upper * (1 - v) + lower * v) * ratios, np.float32)


@njit(cache=True, nogil=True)
def warp(maps: Any, flow: Any, out: Any) -> None:
    """Sample `maps` (H, W, C) bilinearly at pixel + `flow`, with replicated borders, into `out`."""
    height, width, channels = maps.shape
    one, two = np.float32(1), np.float32(2)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    for row in range(height):
        for column in range(width):
            x = two * (np.float32(column) + flow[row, column, 0]) / max(right, one) - one
            y = two * (np.float32(row) + flow[row, column, 1]) / max(bottom, one) - one
            x = min(max((x + one) / two * right, np.float32(0)), right)
            y = min(max((y + one) / two * bottom, np.float32(0)), bottom)
            x0, y0 = int(x), int(y)
            x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
            u, v = np.float32(x - x0), np.float32(y - y0)
            a, b = (np.float32(1) - u) * (np.float32(1) - v), u * (np.float32(1) - v)
            c, d = (np.float32(1) - u) * v, u * v
            for channel in range(channels):
                out[row, column, channel] = (
                    a * maps[y0, x0, channel]
                    + b * maps[y0, x1, channel]
                    + c * maps[y1, x0, channel]
                    + d * maps[y1, x1, channel]
                )


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def correlate(first: Any, second: Any, radius: Any, out: Any) -> None:
    """Write the mean products of `first` with `second` within `radius` (zero outside) to `out`, row by row."""
    height, width, channels = first.shape
    side = 2 * radius + 1
    for row in range(height):
        for column in range(width):
            own = first[row, column]
            for index in range(side * side):
                y, x = row + index // side - radius, column + index % side - radius
                total = np.float32(0)
                if 0 <= y < height and 0 <= x < width:
                    other = second[y, x]
                    for channel in range(channels):
                        total += own[channel] * other[channel]
                out[row, column, index] = total / np.float32(channels)


def enlarge(flow: Maps, mask: Maps, factor: int) -> Maps:
    """Upsample `flow` (H, W, 2) to (factor * H, factor * W, 2) and scale its values. Each fine pixel is the mean of 3 x
    3 coarse pixels (zero outside the map), weighted by the softmax of `mask` (H, W, 9 * factor ** 2).
    """
    height, width, _ = flow.shape
    weights = mask.reshape(height, width, 9, factor * factor)
    weights = weights - weights.max(axis=2, keepdims=True)
    np.exp(weights, out=weights)
    padded = np.pad(np.float32(factor) * flow, ((1, 1), (1, 1), (0, 0)))
    around = sliding_window_view(padded, (3, 3), (0, 1)).reshape(height, width, 2, 9)
    fine = (around @ weights) / weights.sum(axis=2, keepdims=True)
    fine = fine.reshape(height, width, 2, factor, factor).transpose(0, 3, 1, 4, 2)
    return fine.reshape(height * factor, width * factor, 2)


CHANNELS = (3, 16, 32, 48, 64, 80)
"""Numbers of channels: of the image, then of the levels 1/2 to 1/32."""
LEVELS = len(CHANNELS) - 1
MULTIPLE = 2**LEVELS
"""The input's height and width must be multiples of this number."""
RADIUS = 3
"""Radius of the correlation window, in pixels of a level."""
REDUCED = 32
"""Number of feature channels that each level passes to the decoder."""
DECODER = ((80, 1), (64, 2), (48, 4), (32, 1))
"""Number of channels and dilation of each convolution in the decoder."""
FINEST = 4
"""Finest resolution at which the flow is decoded: 1/4 of the frame's size."""
EPSILON = 1e-6
"""Constant added to the mean square of the features; the features are divided by the square root of the sum."""
