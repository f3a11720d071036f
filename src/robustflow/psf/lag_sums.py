"""The convolution along one axis of `rounded_blur`, without a transform.

A blur whose kernels change every few rows needs a transform for each change; a sum over at most 61 lags needs none,
blends two kernels for each row as it goes, and serves the image and its mirror image, both also upside down, with one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compile_late import njit_late

LANES = 8
"""Lags are summed in groups of this many, of which the last may reach beyond the kernel, into zeros."""

_ZERO = np.float32(0.0)
_U = np.uint64  # an index that is never negative needs no test for it, and the loop over lags can take eight at once


@njit_late(
    "void(float32[:,:,:,::1], float32[:,:,::1], int64, int64[::1], int64[::1], float32[:,::1], float32[:,:,:,::1])",
    cache=True,
    fastmath=True,
    nogil=True,
    error_model="numpy",
)
def lag_sums(spectra: Any, kernels: Any, lags: Any, reaches: Any, tops: Any, windows: Any, out: Any) -> None:
    """Convolve and window the columns of an image whose rows are spectra; the fastest way, not bit-exact.

    Args:
        spectra: (2, 3, F, 2 R), an image of R rows and its left-right mirror image, real and imaginary parts in turns.
        kernels: (3, F, 2 n L), of the n nodes below the centre, each L real and L imaginary parts: `lags` of them,
            last lag first, and at least `LANES` zeros.
        lags: an odd number, the middle one of which is no lag.
        reaches: (n,), the largest lag at which a node's kernel is not zero.
        tops: (n,), the row of R at which the window of a node begins.
        windows: (n, W), weights of rows; at most two nodes have one at a row.
        out: (2, 3, F, 2 H) receives the H rows in the middle of R, the kernels used above the centre upside down.
    """
    rows, frequencies, nodes, window = spectra.shape[3] // 2, kernels.shape[1], reaches.size, windows.shape[1]
    height = out.shape[3] // 2
    pitch = kernels.shape[2] // (2 * nodes)
    margin = (rows - height) // 2
    first, last = max(tops[0], margin), min(tops[nodes - 1] + window, margin + height)
    near, far, reach = np.zeros(rows, np.int64), np.zeros(rows, np.int64), np.zeros(rows, np.int64)
    near_weight, far_weight = np.zeros(rows, np.float32), np.zeros(rows, np.float32)
    for p in range(first, last):
        i = 0
        while i < nodes - 1 and tops[i + 1] <= p:
            i += 1
        j = max(i - 1, 0)
        near[p], far[p], reach[p] = i, j, reaches[i]
        near_weight[p] = windows[i, p - tops[i]] if p - tops[i] < window else _ZERO
        if i > 0 and p - tops[j] < window:
            far_weight[p] = windows[j, p - tops[j]]
            reach[p] = max(reach[p], reaches[j])
    stride = rows + LANES
    s, pitch_u = _U(stride), _U(pitch)
    lines = np.zeros(8 * stride, np.float32)  # image, upside down, mirrored, both; real parts, imaginary parts
    sums = np.zeros((4, 2, rows), np.float32)
    for channel in range(3):
        for f in range(frequencies):
            kernel = kernels[channel, f]
            for m in range(2):
                line = spectra[m, channel, f]
                for r in range(rows):
                    real, imaginary = line[2 * r], line[2 * r + 1]
                    lines[4 * m * stride + r] = real
                    lines[(4 * m + 1) * stride + r] = imaginary
                    lines[(4 * m + 3) * stride - LANES - 1 - r] = real
                    lines[(4 * m + 4) * stride - LANES - 1 - r] = imaginary
            for p in range(first, last):
                r, a, b = reach[p], near_weight[p], far_weight[p]
                k, z = _U(2 * near[p] * pitch + lags // 2 - r), _U(2 * far[p] * pitch + lags // 2 - r)
                begin = _U(p - r)
                x0, y0, x1, y1, x2, y2, x3, y3 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
                for lag in range(_U((2 * r + LANES) // LANES * LANES)):
                    u = a * kernel[k + lag] + b * kernel[z + lag]
                    v = a * kernel[k + pitch_u + lag] + b * kernel[z + pitch_u + lag]
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
                line = out[m, channel, f]
                for y in range(height):
                    for part in range(2):
                        line[2 * y + part] = sums[2 * m, part, y + margin] + sums[2 * m + 1, part, y + margin]
