"""Inverse search: find the displacement of every patch by gradient descent (Kroeger et al. 2016, section 2.1).

A patch T of frame 1 is matched to frame 2, I, by minimising the sum over pixels x and channels of (I(x + u) - T(x))^2,
with the mean of each channel subtracted from both. Each step is u -= H^-1 sum S (I(x + u) - T(x)), where S is the
gradient of T and H = sum S S^T. Because only the gradient of T is used, H is computed only once.

Two identities make a step cheap and affect only rounding. First, if the mean of S is subtracted, sum S (I - T) does not
depend on the means of I and T. Second, I between pixels is a weighted sum of 4x4 spline coefficients, so sum S I(x + u)
is the same weighted sum of its values at 4x4 integer displacements. Each of these values is computed only once per
patch, and reused in later steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.types import Flow
from .pyramid import Image, coefficients, slopes, spline_weights, with_border

_TAPS = 3
"""Number of pixels around a patch that are needed for interpolation."""


def grid(size: int, patch: int, stride: int) -> npt.NDArray[np.int64]:
    """Return the start of each patch along an axis: every `stride` pixels, with the last patch flush with the end."""
    return np.append(np.arange(0, size - patch, stride, dtype=np.int64), size - patch)


def search_area(image: Image, patch: int) -> Image:
    """Pad frame 2 by edge replication, as far as `in_search_area` allows patches to move."""
    return with_border(image, patch + _TAPS)


@inner
def in_search_area(place: float, size: int, patch: int) -> tuple[int, float]:
    """Return the integer and fractional parts of the coordinate in `search_area` of a patch at `place` in frame 2."""
    inside = min(max(place, float(-patch)), float(size)) + (patch + _TAPS)
    whole = int(inside)
    return whole, inside - whole


@inner
def from_coarser(coarse: Any, y: float, x: float) -> tuple[float, float]:
    """Return (u, v) at a position in pixels of the finer scale: twice the coarse flow, interpolated bilinearly."""
    height, width, _ = coarse.shape
    at_y = min(max((y + 0.5) / 2 - 0.5, 0.0), height - 1.0)
    at_x = min(max((x + 0.5) / 2 - 0.5, 0.0), width - 1.0)
    y0, x0 = int(at_y), int(at_x)
    y1, x1 = min(y0 + 1, height - 1), min(x0 + 1, width - 1)
    b, a = at_y - y0, at_x - x0
    w00, w01, w10, w11 = (1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a
    u = w00 * coarse[y0, x0, 0] + w01 * coarse[y0, x1, 0] + w10 * coarse[y1, x0, 0] + w11 * coarse[y1, x1, 0]
    v = w00 * coarse[y0, x0, 1] + w01 * coarse[y0, x1, 1] + w10 * coarse[y1, x0, 1] + w11 * coarse[y1, x1, 1]
    return 2 * u, 2 * v


Displacements = npt.NDArray[np.float32]
"""Displacements (u, v) in pixels of the patches at `grid(H, ...)` x `grid(W, ...)`, float32 (rows, columns, 2)."""


def inverse_search(
    image1: Image, image2: Image, coarse: Flow, patch: int, stride: int, iterations: int
) -> Displacements:
    """Find the displacements of a grid of patches."""
    height, width = image1.shape[0], image1.shape[1] // 3
    rows, columns = grid(height, patch, stride), grid(width, patch, stride)
    displacements = np.empty((rows.size, columns.size, 2), np.float32)
    around, slope = search_area(image2, patch), slopes(image1, 2)
    _search(image1, *slope, around, coefficients(around), coarse, (rows, columns), patch, iterations, displacements)
    return displacements


@njit(cache=True, nogil=True)
def _search(
    image1: Any,
    slope_x: Any,
    slope_y: Any,
    image2: Any,
    spline2: Any,
    coarse: Any,
    corners: Any,
    patch: int,
    steps: int,
    displacements: Any,
) -> None:
    rows, columns = corners
    sx, sy = np.empty((patch, 3 * patch), np.float32), np.empty((patch, 3 * patch), np.float32)
    lanes = np.empty((2, 3 * patch), np.float32)
    side = 2 * patch + 8
    sums, owner = np.empty((side, side, 2)), np.full((side, side), -1, np.int64)
    for i in range(rows.size):
        for j in range(columns.size):
            y, x = rows[i], columns[j]
            u0, v0 = from_coarser(coarse, y + 0.5 * (patch - 1), x + 0.5 * (patch - 1))
            displacements[i, j, 0], displacements[i, j, 1] = u0, v0
            _centre(slope_x, y, 3 * x, sx)
            _centre(slope_y, y, 3 * x, sy)
            hessian = _products(sx, sy)
            trace, det = hessian[0] + hessian[2], hessian[0] * hessian[2] - hessian[1] ** 2
            if trace < 0.01 * patch * patch or det < 1e-6 * trace * trace:
                continue
            wanted = _project(image1, y, 3 * x, sx, sy, lanes)
            memory = (i * columns.size + j, owner, sums)
            u, v = _descend(image1, spline2, (y, x), (u0, v0), (sx, sy), hessian, wanted, steps, memory, lanes)
            if (u - u0) ** 2 + (v - v0) ** 2 > patch * patch:
                continue
            before = _mismatch(image1, image2, y, x, u0, v0, patch, lanes)
            if _mismatch(image1, image2, y, x, u, v, patch, lanes) <= before:
                displacements[i, j, 0], displacements[i, j, 1] = u, v


@inner
def _descend(
    image1: Any,
    spline2: Any,
    corner: Any,
    begin: Any,
    slope: Any,
    hessian: Any,
    wanted: Any,
    steps: int,
    memory: Any,
    lanes: Any,
) -> tuple[float, float]:
    """Return the final displacement of a patch. `memory` caches the sums at integer displacements for this patch."""
    (y, x), (u0, v0), (sx, sy), (hxx, hxy, hyy), (patch_id, owner, sums) = corner, begin, slope, hessian, memory
    height, width, patch = image1.shape[0], image1.shape[1] // 3, sx.shape[0]
    top = in_search_area(y + v0, height, patch)[0] - patch - 2
    left = in_search_area(x + u0, width, patch)[0] - patch - 2
    det = hxx * hyy - hxy * hxy
    u, v = u0, v0
    for _ in range(steps):
        y0, wy = in_search_area(y + v, height, patch)
        x0, wx = in_search_area(x + u, width, patch)
        down, right = spline_weights(wy), spline_weights(wx)
        bx, by = -wanted[0], -wanted[1]
        for a in range(4):
            for b in range(4):
                row, column = y0 + a - 1, x0 + b - 1
                cell = sums[row - top, column - left]
                if owner[row - top, column - left] != patch_id:
                    owner[row - top, column - left] = patch_id
                    cell[0], cell[1] = _project(spline2, row, 3 * column, sx, sy, lanes)
                weight = down[a] * right[b]
                bx += weight * cell[0]
                by += weight * cell[1]
        du, dv = (hyy * bx - hxy * by) / det, (hxx * by - hxy * bx) / det
        u, v = u - du, v - dv
        if abs(u - u0) > patch or abs(v - v0) > patch or du * du + dv * dv < 1e-6:
            break
    return u, v


@inner
def _centre(slope: Any, row: int, column: int, out: Any) -> None:
    """Copy a patch of a derivative image into `out` and subtract the mean of each channel."""
    patch, columns = out.shape
    for c in range(3):
        total = 0.0
        for r in range(patch):
            for k in range(c, columns, 3):
                total += slope[row + r, column + k]
        mean = np.float32(total / (patch * patch))
        for r in range(patch):
            for k in range(c, columns, 3):
                out[r, k] = slope[row + r, column + k] - mean


@inner
def _products(sx: Any, sy: Any) -> tuple[float, float, float]:
    hxx = hxy = hyy = 0.0
    for r in range(sx.shape[0]):
        for k in range(sx.shape[1]):
            hxx += sx[r, k] * sx[r, k]
            hxy += sx[r, k] * sy[r, k]
            hyy += sy[r, k] * sy[r, k]
    return hxx, hxy, hyy


@inner
def _project(image: Any, row: int, column: int, sx: Any, sy: Any, lanes: Any) -> tuple[float, float]:
    """Sum a patch of `image` times `sx` and `sy`, first over columns in a vectorised loop."""
    a, b = lanes[0], lanes[1]
    for k in range(a.size):
        a[k] = b[k] = 0
    for r in range(sx.shape[0]):
        pixels, p, q = image[row + r, column : column + a.size], sx[r], sy[r]
        for k in range(a.size):
            a[k] += pixels[k] * p[k]
            b[k] += pixels[k] * q[k]
    total_a = total_b = 0.0
    for k in range(a.size):
        total_a += a[k]
        total_b += b[k]
    return total_a, total_b


@inner
def _mismatch(image1: Any, image2: Any, y: int, x: int, u: float, v: float, patch: int, lanes: Any) -> float:
    """Return the sum of squares between a patch and its bilinear match, without each channel's mean."""
    y0, at_y = in_search_area(y + v, image1.shape[0], patch)
    x0, at_x = in_search_area(x + u, image1.shape[1] // 3, patch)
    wy, wx = np.float32(at_y), np.float32(at_x)
    w00, w01 = (np.float32(1) - wy) * (np.float32(1) - wx), (np.float32(1) - wy) * wx
    w10, w11 = wy * (np.float32(1) - wx), wy * wx
    a, b = lanes[0], lanes[1]
    for k in range(a.size):
        a[k] = b[k] = 0
    for r in range(patch):
        here = image1[y + r, 3 * x : 3 * (x + patch)]
        above, below = image2[y0 + r, 3 * x0 :], image2[y0 + r + 1, 3 * x0 :]
        for k in range(a.size):
            there = (w00 * above[k] + w01 * above[k + 3]) + (w10 * below[k] + w11 * below[k + 3])
            a[k] += there - here[k]
            b[k] += (there - here[k]) * (there - here[k])
    total = 0.0
    for c in range(3):
        of_channel = 0.0
        for k in range(c, a.size, 3):
            of_channel += a[k]
            total += b[k]
        total -= of_channel * of_channel / (patch * patch)
    return total
