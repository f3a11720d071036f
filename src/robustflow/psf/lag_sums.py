"""The compiled loops of `rounded_blur`, of which `lag_sums` is the convolution along one axis without a transform.

A blur whose kernels change every few rows needs a transform for each change; a sum over 61 lags needs none, blends
two kernels for each row as it goes, and serves the image, its mirror images and both upside down with one kernel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from .tiles import SUPPORT

_MIDDLE = SUPPORT // 2
_LANES = 8
"""Lags are summed in groups of this many, of which the last may reach beyond the kernel, into zeros."""
_PITCH = SUPPORT // _LANES * _LANES + 2 * _LANES
_U = np.uint64  # an index that is never negative needs no test for it, and the loop over lags can take four at once


@njit(
    "void(float64[:,:,:,::1], float32[:,:,:,:,::1], int64[::1], int64[::1], float64[:,::1], float64[:,:,:,::1])",
    cache=True,
    fastmath=True,
    nogil=True,
    error_model="numpy",
)
def lag_sums(spectra: Any, kernels: Any, reaches: Any, tops: Any, windows: Any, out: Any) -> None:
    """The rows of an image that is a spectrum along its rows, convolved and windowed; the fastest way, not bit-exact.

    Args:
        spectra: (2, 3, R, 2 F), an image and its left-right mirror image, real and imaginary parts in turns.
        kernels: (3, F, n, 2, 61), of the nodes below the centre, real parts and imaginary parts, last lag first.
        reaches: (n,), the largest lag at which a node's kernel is not zero.
        tops: (n,), the row of R at which the window of a node begins.
        windows: (n, W), weights of rows; at most two nodes have one at a row.
        out: (2, 3, H, 2 F) receives the H rows in the middle of R, the kernels used above the centre upside down.
    """
    rows, frequencies, nodes, window = spectra.shape[2], kernels.shape[1], kernels.shape[2], windows.shape[1]
    height = out.shape[2]
    margin = (rows - height) // 2
    first, last = max(tops[0], margin), min(tops[nodes - 1] + window, margin + height)
    near, far, reach = np.zeros(rows, np.int64), np.zeros(rows, np.int64), np.zeros(rows, np.int64)
    near_weight, far_weight = np.zeros(rows), np.zeros(rows)
    for p in range(first, last):
        i = 0
        while i < nodes - 1 and tops[i + 1] <= p:
            i += 1
        j = i - 1 if i > 0 else nodes  # there is a node of zeros after the last
        near[p], far[p], reach[p] = i, j, reaches[i]
        near_weight[p] = windows[i, p - tops[i]] if p - tops[i] < window else 0.0
        if i > 0 and p - tops[j] < window:
            far_weight[p] = windows[j, p - tops[j]]
            reach[p] = max(reach[p], reaches[j])
    stride = rows + _LANES
    s = _U(stride)
    lines = np.zeros(8 * stride)  # image, upside down, mirrored, both; of each the real and the imaginary parts
    lags = np.zeros((nodes + 1) * 2 * _PITCH)
    sums = np.zeros((4, 2, rows))
    for channel in range(3):
        for f in range(frequencies):
            for m in range(2):
                for r in range(rows):
                    real, imaginary = spectra[m, channel, r, 2 * f], spectra[m, channel, r, 2 * f + 1]
                    lines[4 * m * stride + r] = real
                    lines[(4 * m + 1) * stride + r] = imaginary
                    lines[(4 * m + 3) * stride - _LANES - 1 - r] = real
                    lines[(4 * m + 4) * stride - _LANES - 1 - r] = imaginary
            for i in range(nodes):
                for part in range(2):
                    for lag in range(SUPPORT):
                        lags[(2 * i + part) * _PITCH + lag] = kernels[channel, f, i, part, lag]
            sums[:] = 0.0
            for p in range(first, last):
                r, a, b = reach[p], near_weight[p], far_weight[p]
                k, z = _U(2 * near[p] * _PITCH + _MIDDLE - r), _U(2 * far[p] * _PITCH + _MIDDLE - r)
                begin = _U(p - r)
                x0, y0, x1, y1, x2, y2, x3, y3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for lag in range(_U((2 * r + _LANES) // _LANES * _LANES)):
                    u = a * lags[k + lag] + b * lags[z + lag]
                    v = a * lags[k + _U(_PITCH) + lag] + b * lags[z + _U(_PITCH) + lag]
                    q = begin + lag
                    c0, d0, c1, d1 = lines[q], lines[q + s], lines[q + _U(2) * s], lines[q + _U(3) * s]
                    q += _U(4) * s
                    c2, d2, c3, d3 = lines[q], lines[q + s], lines[q + _U(2) * s], lines[q + _U(3) * s]
                    x0 += u * c0
                    x0 -= v * d0
                    y0 += u * d0
                    y0 += v * c0
                    x1 += u * c1
                    x1 -= v * d1
                    y1 += u * d1
                    y1 += v * c1
                    x2 += u * c2
                    x2 -= v * d2
                    y2 += u * d2
                    y2 += v * c2
                    x3 += u * c3
                    x3 -= v * d3
                    y3 += u * d3
                    y3 += v * c3
                sums[0, 0, p], sums[0, 1, p], sums[2, 0, p], sums[2, 1, p] = x0, y0, x2, y2
                p = rows - 1 - p
                sums[1, 0, p], sums[1, 1, p], sums[3, 0, p], sums[3, 1, p] = x1, y1, x3, y3
            for m in range(2):
                for y in range(height):
                    for part in range(2):
                        upright, turned = sums[2 * m, part, y + margin], sums[2 * m + 1, part, y + margin]
                        out[m, channel, y, 2 * f + part] = upright + turned


@njit("void(float64[:,:,:,::1], float64[::1], int64, float64[:,:,::1])", cache=True, nogil=True)
def add_strip(strip: Any, window: Any, left: Any, total: Any) -> None:
    """Add a strip (2, 3, H, N) of an image and of its mirror image, windowed, to the image (3, H, W) from a column on.

    The last columns of the strip count, as many as `window` has (n,).
    """
    skipped, right = strip.shape[3] - window.size, total.shape[2] - left
    for channel in range(3):
        for y in range(total.shape[1]):
            plain, mirror = strip[0, channel, y, skipped:], strip[1, channel, y, skipped:]
            to_plain = total[channel, y, left : left + window.size]
            to_mirror = total[channel, y, right - window.size : right]
            for x in range(window.size):
                to_plain[x] += plain[x] * window[x]
            for x in range(window.size):
                to_mirror[window.size - 1 - x] += mirror[x] * window[x]


@njit("int64(float64[:,:,::1], int64, float64, uint8[:,:,::1], int64[:,::1])", cache=True, nogil=True)
def round_all(total: Any, left: Any, margin: Any, rounded: Any, close: Any) -> Any:
    """Round to bytes; note what lies closer than `margin` to the middle between two.

    Args:
        total: (3, H, at least left + W), grey levels.
        left: the first column that counts.
        margin: grey levels.
        rounded: (H, W, 3) receives the bytes.
        close: (n, 3) receives y, x and channel of the first n values that are close.

    Returns:
        How many are close.
    """
    count = 0
    for y in range(rounded.shape[0]):
        for x in range(rounded.shape[1]):
            for channel in range(3):
                value = total[channel, y, left + x]
                nearest = np.floor(value + 0.5)
                rounded[y, x, channel] = np.uint8(min(max(nearest, 0.0), 255.0))
                if 0.5 - abs(value - nearest) < margin:
                    if count < close.shape[0]:
                        close[count, 0], close[count, 1], close[count, 2] = y, x, channel
                    count += 1
    return count


@njit("float64(int16[:,::1], uint8[:,::1], float64, int64[::1], int64[::1], int64[::1], int64[::1])", cache=True)
def dot(kernel: Any, plane: Any, grey: Any, lags_y: Any, inputs_y: Any, lags_x: Any, inputs_x: Any) -> Any:
    """The sum of pixels of (H, W), less `grey`, times the elements of a kernel (N, N) that belong to them.

    `lags` are the indices into the kernel and `inputs` those into the plane, (N,) of either axis.
    """
    total = 0.0
    for i in range(lags_y.size):
        line, pixels = kernel[lags_y[i]], plane[inputs_y[i]]
        for j in range(lags_x.size):
            total += line[lags_x[j]] * (pixels[inputs_x[j]] - grey)
    return total
