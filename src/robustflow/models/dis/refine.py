"""Refine dense flow variationally (Kroeger et al. 2016, section 2.4).

Around the current flow, the constancy of an image quantity q means q_x du + q_y dv + q_t = 0. The square of the left
side, divided by |grad q|^2 + 0.01 to obtain a squared distance in pixels, and summed over channels, is a quadratic form
in (du, dv, 1). In E_I, q stands for the colours; in E_G, for their two derivatives.

The energy minimised around a flow (u, v) is the sum over pixels of delta Psi(E_I) + gamma Psi(E_G) + alpha Psi(E_S),
where Psi(s^2) = sqrt(s^2 + 0.001^2), E_I and E_G are the forms of `motion_tensor`, and E_S = |grad u|^2 + |grad v|^2.
Each fixed-point iteration holds the derivatives of Psi constant, which yields a linear system, and solves this system
approximately with a few sweeps of successive over-relaxation, in red-black order so that no direction is favoured. The
weights, the number of sweeps and the relaxation factor are the same as in the authors' program.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.types import Flow
from .pyramid import Image, coefficients, mirrored_once, slopes, spline_weights

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
    """Warp frame 2 backwards; write its mean with frame 1 to `middle`, and their difference to `change`."""
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


DELTA, GAMMA, ALPHA = 5.0, 10.0, 10.0
"""Weights of E_I, E_G and E_S."""
RELAXATION, SWEEPS = 1.6, 3
_EPSILON = 1e-3


def refined(image1: Image, image2: Image, flow: Flow, iterations: int) -> Flow:
    """Refine a flow with `iterations` fixed-point iterations."""
    tensors = motion_tensors(image1, image2, flow)
    height, width, _ = flow.shape
    better = flow.copy()
    system = np.empty((height, width, 5), np.float32)
    smooth = np.empty((height, width), np.float32)
    links = np.zeros((2, height + 1, width + 1), np.float32)
    for _ in range(iterations):
        _hold(tensors, flow, better, np.float32(DELTA), np.float32(GAMMA), np.float32(ALPHA), system, smooth)
        _link(smooth, links)
        for _ in range(SWEEPS):
            for colour in range(2):
                _relax(system, links, flow, colour, np.float32(RELAXATION), better)
    return better


@njit(cache=True, nogil=True)
def _hold(tensors: Any, flow: Any, better: Any, delta: Any, gamma: Any, alpha: Any, system: Any, smooth: Any) -> None:
    """Write the linear system of each pixel (xx, xy, yy, right-hand sides) and the smoothness weights."""
    height, width, _ = flow.shape
    zero, two, least = np.float32(0), np.float32(2), np.float32(_EPSILON * _EPSILON)
    for y in range(height):
        for x in range(width):
            du, dv = better[y, x, 0] - flow[y, x, 0], better[y, x, 1] - flow[y, x, 1]
            s = system[y, x]
            s[:] = 0
            for term in range(2):
                t = tensors[y, x, term]
                square = t[0] * du * du + two * t[1] * du * dv + t[2] * dv * dv + two * (t[3] * du + t[4] * dv) + t[5]
                weight = (gamma if term else delta) / np.sqrt(max(square, zero) + least)
                for k in range(3):
                    s[k] += weight * t[k]
                s[3] -= weight * t[3]
                s[4] -= weight * t[4]
            slope = least
            for i in range(2):
                right = better[y, min(x + 1, width - 1), i] - better[y, max(x - 1, 0), i]
                down = better[min(y + 1, height - 1), x, i] - better[max(y - 1, 0), x, i]
                slope += np.float32(0.25) * (right * right + down * down)
            smooth[y, x] = alpha / np.sqrt(slope)


@njit(cache=True, nogil=True)
def _link(smooth: Any, links: Any) -> None:
    """Write the weights between neighbours: links[0] between (y, x - 1) and (y, x), links[1] between rows."""
    height, width = smooth.shape
    half = np.float32(0.5)
    for y in range(height):
        for x in range(1, width):
            links[0, y, x] = half * (smooth[y, x - 1] + smooth[y, x])
    for y in range(1, height):
        for x in range(width):
            links[1, y, x] = half * (smooth[y - 1, x] + smooth[y, x])


@njit(cache=True, nogil=True)
def _relax(system: Any, links: Any, flow: Any, colour: int, omega: Any, better: Any) -> None:
    height, width, _ = flow.shape
    for y in range(height):
        for x in range((y + colour) % 2, width, 2):
            left, right, up, down = links[0, y, x], links[0, y, x + 1], links[1, y, x], links[1, y + 1, x]
            pull_u = pull_v = np.float32(0)
            if x > 0:
                pull_u += left * better[y, x - 1, 0]
                pull_v += left * better[y, x - 1, 1]
            if x < width - 1:
                pull_u += right * better[y, x + 1, 0]
                pull_v += right * better[y, x + 1, 1]
            if y > 0:
                pull_u += up * better[y - 1, x, 0]
                pull_v += up * better[y - 1, x, 1]
            if y < height - 1:
                pull_u += down * better[y + 1, x, 0]
                pull_v += down * better[y + 1, x, 1]
            total = left + right + up + down
            u, v, s = flow[y, x, 0], flow[y, x, 1], system[y, x]
            du, dv = better[y, x, 0] - u, better[y, x, 1] - v
            du += omega * ((s[3] - s[1] * dv + pull_u - total * u) / (s[0] + total) - du)
            dv += omega * ((s[4] - s[1] * du + pull_v - total * v) / (s[2] + total) - dv)
            better[y, x, 0], better[y, x, 1] = u + du, v + dv
