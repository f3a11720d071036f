"""The image pyramid of the search, derivatives, upsampling of the flow, and interpolation with cubic splines.

Other interpolations blur by an amount that depends on the subpixel position, which biases matches towards integer
displacements: at 1/8 resolution by up to 0.4 px with Catmull-Rom weights, and 0.1 px with splines.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.types import Flow, Frame

Image = npt.NDArray[np.float32]
"""An image with rows of interleaved RGB, values 0 to 255, float32 (H, 3 W)."""

_HALF = tuple(np.float32(weight / 320) for weight in (1, 13, 51, 95))
"""Filter weights of one side, outermost first; slightly wider than 1 5 10 10 5 1, to reduce aliasing."""


def pyramid(frame: Frame, height: int, width: int, coarsest: int) -> list[Image]:
    """Return the frame at scales 0 to `coarsest`, each half the size of the previous one."""
    full = np.empty((height, 3 * width), np.float32)
    _extend(contiguous(frame), full)
    levels = [full]
    for _ in range(coarsest):
        rows, columns = levels[-1].shape
        levels.append(np.empty((rows // 2, columns // 2), np.float32))
        _halve(levels[-2], levels[-1])
    return levels


def with_border(image: Image, border: int) -> Image:
    """Pad an image by repeating its edge pixels `border` times on every side: (H + 2 border, 3 (W + 2 border))."""
    height, columns = image.shape
    out = np.empty((height + 2 * border, columns + 6 * border), np.float32)
    _border(image, border, out)
    return out


def slopes(image: Image, order: int) -> tuple[Image, Image]:
    """Return the derivatives in x and y per pixel: central differences of order 2 or 4, with replicated edges."""
    near, far = {2: (1 / 2, 0.0), 4: (2 / 3, 1 / 12)}[order]
    right, down = np.empty_like(image), np.empty_like(image)
    _slopes(image, np.float32(near), np.float32(far), right, down)
    return right, down


def enlarged(flow: Flow, factor: int, height: int, width: int) -> Flow:
    """Upsample a flow bilinearly by `factor`, and crop it to (height, width, 2)."""
    out = np.empty((height, width, 2), np.float32)
    _enlarge(flow, factor, out)
    return out


@njit(cache=True, nogil=True)
def _extend(frame: Any, out: Any) -> None:
    height, width, _ = frame.shape
    for y in range(out.shape[0]):
        for x in range(out.shape[1] // 3):
            for c in range(3):
                out[y, 3 * x + c] = frame[min(y, height - 1), min(x, width - 1), c]


@njit(cache=True, nogil=True)
def _halve(image: Any, out: Any) -> None:
    """Halve `image` along both axes with the symmetric filter `_HALF` and replicated edges."""
    height, columns = image.shape
    a, b, c, d = _HALF
    row = np.empty(columns + 18, np.float32)
    for y in range(out.shape[0]):
        at, last = 2 * y, height - 1
        r0, r1, r2, r3 = image[max(at - 3, 0)], image[max(at - 2, 0)], image[max(at - 1, 0)], image[at]
        r4, r5, r6 = image[at + 1], image[min(at + 2, last)], image[min(at + 3, last)]
        r7 = image[min(at + 4, last)]
        for i in range(columns):
            row[9 + i] = (a * (r0[i] + r7[i]) + b * (r1[i] + r6[i])) + (c * (r2[i] + r5[i]) + d * (r3[i] + r4[i]))
        for i in range(9):
            row[i] = row[9 + i % 3]
            row[9 + columns + i] = row[6 + columns + i % 3]
        for x in range(out.shape[1] // 3):
            for k in range(3):
                p = row[6 * x + k : 6 * x + k + 22]
                out[y, 3 * x + k] = (a * (p[0] + p[21]) + b * (p[3] + p[18])) + (
                    c * (p[6] + p[15]) + d * (p[9] + p[12])
                )


@njit(cache=True, nogil=True)
def _border(image: Any, border: int, out: Any) -> None:
    height, columns = image.shape
    for y in range(out.shape[0]):
        source, target = image[min(max(y - border, 0), height - 1)], out[y]
        for i in range(columns):
            target[3 * border + i] = source[i]
        for i in range(3 * border):
            target[i] = source[i % 3]
            target[3 * border + columns + i] = source[columns - 3 + i % 3]


@njit(cache=True, nogil=True)
def _slopes(image: Any, near: Any, far: Any, right: Any, down: Any) -> None:
    height, columns = image.shape
    last = height - 1
    row = np.empty(columns + 12, np.float32)
    for y in range(height):
        for i in range(columns):
            row[6 + i] = image[y, i]
        for i in range(6):
            row[i] = image[y, i % 3]
            row[6 + columns + i] = image[y, columns - 3 + i % 3]
        for i in range(columns):
            right[y, i] = near * (row[i + 9] - row[i + 3]) - far * (row[i + 12] - row[i])
        up2, up1, down1, down2 = max(y - 2, 0), max(y - 1, 0), min(y + 1, last), min(y + 2, last)
        for i in range(columns):
            down[y, i] = near * (image[down1, i] - image[up1, i]) - far * (image[down2, i] - image[up2, i])


@njit(cache=True, nogil=True)
def _enlarge(flow: Any, factor: int, out: Any) -> None:
    height, width, _ = flow.shape
    scale = np.float32(factor)
    for y in range(out.shape[0]):
        at_y = min(max((y + 0.5) / factor - 0.5, 0.0), height - 1.0)
        y0 = int(at_y)
        y1, wy = min(y0 + 1, height - 1), np.float32(at_y - y0)
        for x in range(out.shape[1]):
            at_x = min(max((x + 0.5) / factor - 0.5, 0.0), width - 1.0)
            x0 = int(at_x)
            x1, wx = min(x0 + 1, width - 1), np.float32(at_x - x0)
            for i in range(2):
                above = flow[y0, x0, i] + wx * (flow[y0, x1, i] - flow[y0, x0, i])
                below = flow[y1, x0, i] + wx * (flow[y1, x1, i] - flow[y1, x0, i])
                out[y, x, i] = scale * (above + wy * (below - above))


_POLE = math.sqrt(3) - 2
_MEMORY = 32
"""Number of pixels after which the influence of a pixel, `_POLE**i`, is less than the rounding error of float64."""


def coefficients(image: Image) -> Image:
    """Return the spline coefficients for `spline_weights`; the frame is mirrored about its edge pixels."""
    height, columns = image.shape
    weighed = image.astype(np.float64)
    _filter(weighed)
    for row in weighed.reshape(height, columns // 3, 3):
        _filter(row)
    return weighed.astype(np.float32)


@njit(cache=True, nogil=True)
def _filter(lines: Any) -> None:
    """Replace the pixels along the first axis of float64 (N, K) by their spline coefficients (Unser 1999, box 2)."""
    size, columns = lines.shape
    first, power = lines[0].copy(), 1.0
    for i in range(1, _MEMORY):
        power *= _POLE
        place = i % (2 * size - 2)
        other = lines[min(place, 2 * size - 2 - place)]
        for k in range(columns):
            first[k] += power * other[k]
    for k in range(columns):
        lines[0, k] = 6.0 * first[k]
    for i in range(1, size):
        for k in range(columns):
            lines[i, k] = 6.0 * lines[i, k] + _POLE * lines[i - 1, k]
    for k in range(columns):
        lines[size - 1, k] = (_POLE * lines[size - 2, k] + lines[size - 1, k]) * (_POLE / (_POLE * _POLE - 1.0))
    for i in range(size - 2, -1, -1):
        for k in range(columns):
            lines[i, k] = _POLE * (lines[i + 1, k] - lines[i, k])


@njit(cache=True, nogil=True)
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of the coefficients at -1, 0, 1 and 2 for a position `t` in [0, 1]."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (4.0 + s * s * (3.0 * s - 6.0)) / 6.0,
        t * t * t / 6.0,
    )


@njit(cache=True, nogil=True)
def mirrored_once(index: int, size: int) -> int:
    """Mirror `index` about the edge pixels; it may be at most one pixel outside."""
    return abs(index) if index < size else 2 * size - 2 - index
