"""The layers of the small network in NumPy and compiled loops. Maps are float32 (C, H, W)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit

Maps = npt.NDArray[np.float32]
Weights = npt.NDArray[np.float32]

_COLUMNS = 250_000
"""Number of values of the unfolded input that are processed at a time, chosen to fit into a core's cache at any frame
size.
"""
_SLOPE = np.float32(0.1)


def convolve(
    maps: Maps, weight: Weights, bias: Weights, stride: int = 1, dilation: int = 1, linear: bool = False
) -> Maps:
    """Apply a convolution that keeps the size (up to its stride), then LeakyReLU(0.1) unless `linear`.

    Args:
        maps: input maps, (C, H, W).
        weight: weights of the kernel, (O, C, k, k) with k odd.
        bias: bias per output channel, (O,).
        stride: stride, 1 or 2.
        dilation: dilation of the kernel.
        linear: whether to skip the LeakyReLU.

    Returns:
        The output maps, (O, ceil(H / stride), ceil(W / stride)).

    >>> ones = np.ones((1, 2, 3), np.float32)
    >>> convolve(ones, np.ones((1, 1, 3, 3), np.float32), np.zeros(1, np.float32))[0].tolist()
    [[4.0, 6.0, 4.0], [4.0, 6.0, 4.0]]
    """
    channels, height, width = maps.shape
    outputs, _, kernel, _ = weight.shape
    matrix = weight.reshape(outputs, -1)
    high, wide = -(-height // stride), -(-width // stride)
    out = np.empty((outputs, high, wide), np.float32)
    if kernel == 1 and stride == 1:
        np.matmul(matrix, maps.reshape(channels, -1), out=out.reshape(outputs, -1))
    else:
        reach = (kernel - 1) // 2 * dilation
        padded = np.pad(maps, ((0, 0), (reach, reach), (reach, reach)))
        strip = max(1, _COLUMNS // (matrix.shape[1] * wide))
        for top in range(0, high, strip):
            rows = min(strip, high - top)
            columns = np.empty((channels, kernel, kernel, rows, wide), np.float32)
            for y in range(kernel):
                first = top * stride + y * dilation
                for x in range(kernel):
                    last = x * dilation + (wide - 1) * stride + 1
                    columns[:, y, x] = padded[
                        :, first : first + (rows - 1) * stride + 1 : stride, x * dilation : last : stride
                    ]
            out[:, top : top + rows] = (matrix @ columns.reshape(matrix.shape[1], -1)).reshape(outputs, rows, wide)
    out += bias[:, None, None]
    if not linear:
        np.maximum(out, _SLOPE * out, out=out)
    return out


def normalised(maps: Maps, epsilon: float) -> Maps:
    """Normalise features to a mean square of 1 over the channels."""
    mean = np.einsum("chw,chw->hw", maps, maps) / np.float32(len(maps))
    return maps * (np.float32(1.0) / np.sqrt(mean + np.float32(epsilon)))


def resized(flow: Maps, height: int, width: int) -> Maps:
    """Resize a flow (2, h, w) bilinearly with aligned corner pixels, and scale its values."""
    _, high, wide = flow.shape
    y = np.linspace(0, high - 1, height, dtype=np.float64)
    x = np.linspace(0, wide - 1, width, dtype=np.float64)
    rows, columns = (np.minimum(np.floor(at).astype(int), max(side - 2, 0)) for at, side in ((y, high), (x, wide)))
    v, u = (y - rows).astype(np.float32)[:, None], (x - columns).astype(np.float32)
    below, right = np.minimum(rows + 1, high - 1), np.minimum(columns + 1, wide - 1)
    upper = flow[:, rows][:, :, columns] * (1 - u) + flow[:, rows][:, :, right] * u
    lower = flow[:, below][:, :, columns] * (1 - u) + flow[:, below][:, :, right] * u
    ratios = np.array([width / wide, height / high], np.float32)
    return np.asarray((upper * (1 - v) + lower * v) * ratios[:, None, None], np.float32)


@njit(cache=True, nogil=True)
def warp(maps: Any, flow: Any, out: Any) -> None:
    """Sample `maps` (C, H, W) bilinearly at pixel + `flow` (2, H, W), with replicated borders, and write to `out` (C,
    H, W).

    Coordinates are converted to -1..1 in single precision, as in PyTorch's sampler, so that both round in the same way.
    """
    channels, height, width = maps.shape
    one, two = np.float32(1), np.float32(2)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    for row in range(height):
        for column in range(width):
            x = two * (np.float32(column) + flow[0, row, column]) / max(right, one) - one
            y = two * (np.float32(row) + flow[1, row, column]) / max(bottom, one) - one
            x = min(max((x + one) / two * right, np.float32(0)), right)
            y = min(max((y + one) / two * bottom, np.float32(0)), bottom)
            x0, y0 = int(x), int(y)
            x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
            u, v = np.float32(x - x0), np.float32(y - y0)
            a, b = (np.float32(1) - u) * (np.float32(1) - v), u * (np.float32(1) - v)
            c, d = (np.float32(1) - u) * v, u * v
            for channel in range(channels):
                out[channel, row, column] = (
                    a * maps[channel, y0, x0]
                    + b * maps[channel, y0, x1]
                    + c * maps[channel, y1, x0]
                    + d * maps[channel, y1, x1]
                )


@njit(cache=True, nogil=True)
def correlate(first: Any, second: Any, radius: Any, out: Any) -> None:
    """Correlate `first` at each pixel with the pixels of `second` within `radius` (zero outside the map), and write the
    means over channels to `out` ((2 * radius + 1) ** 2, H, W); the window is in row-major order.
    """
    channels, height, width = first.shape
    side = 2 * radius + 1
    for row in range(height):
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                index = (dy + radius) * side + dx + radius
                out[index, row] = np.float32(0)
                if not 0 <= row + dy < height:
                    continue
                left, right = max(0, -dx), min(width, width - dx)
                sums = out[index, row, left:right]
                for channel in range(channels):
                    own = first[channel, row, left:right]
                    other = second[channel, row + dy, left + dx : right + dx]
                    for i in range(right - left):
                        sums[i] += own[i] * other[i]
                for i in range(right - left):
                    sums[i] /= np.float32(channels)


@njit(cache=True, nogil=True)
def enlarge(flow: Any, mask: Any, factor: Any, out: Any) -> None:
    """Upsample `flow` (2, H, W) to `out` (2, factor * H, factor * W) and scale its values. Each fine pixel is the mean
    of 3 x 3 coarse pixels (zero outside the map), weighted by the softmax of `mask` (9 * factor ** 2, H, W).
    """
    _, height, width = flow.shape
    weights = np.empty(9, np.float32)
    for row in range(height):
        for column in range(width):
            for dy in range(factor):
                for dx in range(factor):
                    highest = np.float32(-np.inf)
                    for k in range(9):
                        weights[k] = mask[(k * factor + dy) * factor + dx, row, column]
                        highest = max(highest, weights[k])
                    total = np.float32(0)
                    for k in range(9):
                        weights[k] = np.exp(weights[k] - highest)
                        total += weights[k]
                    u, v = np.float32(0), np.float32(0)
                    for k in range(9):
                        y, x = row + k // 3 - 1, column + k % 3 - 1
                        if 0 <= y < height and 0 <= x < width:
                            u += weights[k] * flow[0, y, x]
                            v += weights[k] * flow[1, y, x]
                    out[0, row * factor + dy, column * factor + dx] = u / total * np.float32(factor)
                    out[1, row * factor + dy, column * factor + dx] = v / total * np.float32(factor)
