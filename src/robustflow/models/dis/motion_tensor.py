"""Quadratic forms of the data terms around the current flow (Kroeger et al. 2016, section 2.4).

Around the current flow, the constancy of an image quantity q means q_x du + q_y dv + q_t = 0. The square of the left
side, divided by |grad q|^2 + 0.01 to obtain a squared distance in pixels, and summed over channels, is a quadratic form
in (du, dv, 1). In E_I, q stands for the colours; in E_G, for their two derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...sample import Flow
from .pyramid import Image, slopes
from .spline import coefficients, mirrored_once, spline_weights

Tensors = npt.NDArray[np.float32]
"""Coefficients xx, xy, yy, xt, yt, tt of E_I and E_G, float32 (H, W, 2, 6)."""


def motion_tensors(image1: Image, image2: Image, flow: Flow) -> Tensors:
    """Compute the quadratic forms around `flow`; they are zero where the flow points outside the frame."""
    height, width, _ = flow.shape
    middle, change = np.empty_like(image1), np.empty_like(image1)
    inside = np.empty((height, width), np.bool_)
    _warp(image1, coefficients(image2), flow, middle, change, inside)
    qx, qy = slopes(middle, 4)
    qxx, qxy = slopes(qx, 4)
    _, qyy = slopes(qy, 4)
    qxt, qyt = slopes(change, 4)
    tensors = np.zeros((height, width, 2, 6), np.float32)
    _accumulate(qx, qy, change, inside, tensors[:, :, 0])
    _accumulate(qxx, qxy, qxt, inside, tensors[:, :, 1])
    _accumulate(qxy, qyy, qyt, inside, tensors[:, :, 1])
    return tensors


@njit(cache=True, nogil=True)
def _warp(image1: Any, spline2: Any, flow: Any, middle: Any, change: Any, inside: Any) -> None:
    """Warp frame 2 backwards along the flow; write the mean of frame 1 and the warped frame to `middle`, and their
    difference to `change`.
    """
    height, width, _ = flow.shape
    half = np.float32(0.5)
    for y in range(height):
        for x in range(width):
            at_y, at_x = y + float(flow[y, x, 1]), x + float(flow[y, x, 0])
            inside[y, x] = 0 <= at_y <= height - 1 and 0 <= at_x <= width - 1
            at_y, at_x = min(max(at_y, 0.0), height - 1.0), min(max(at_x, 0.0), width - 1.0)
            y0, x0 = int(at_y), int(at_x)
            down, right = spline_weights(at_y - y0), spline_weights(at_x - x0)
            for c in range(3):
                there = np.float32(0)
                for a in range(4):
                    row = spline2[mirrored_once(y0 + a - 1, height)]
                    for b in range(4):
                        weight = np.float32(down[a] * right[b])
                        there += weight * row[3 * mirrored_once(x0 + b - 1, width) + c]
                here = image1[y, 3 * x + c]
                middle[y, 3 * x + c] = half * (here + there)
                change[y, 3 * x + c] = there - here


@njit(cache=True, nogil=True)
def _accumulate(qx: Any, qy: Any, qt: Any, inside: Any, tensors: Any) -> None:
    height, width = inside.shape
    one, floor = np.float32(1), np.float32(0.01)
    for y in range(height):
        for x in range(width):
            if not inside[y, x]:
                continue
            t = tensors[y, x]
            for k in range(3 * x, 3 * x + 3):
                a, b, c = qx[y, k], qy[y, k], qt[y, k]
                beta = one / (a * a + b * b + floor)
                t[0] += beta * a * a
                t[1] += beta * a * b
                t[2] += beta * b * b
                t[3] += beta * a * c
                t[4] += beta * b * c
                t[5] += beta * c * c
