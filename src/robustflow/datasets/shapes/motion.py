"""The motion of a layer: an affine map and a smooth wave, with an inverse that is exact up to rounding. For use inside
compiled loops.

Every point of a layer moves in a straight line at constant speed: at time t it is at m + t (T(m) - m), where m is
its position in frame 1 and T(m) its position in frame 2.

Layer coordinates are coordinates of frame 1. A point m moves to T(m) = c + t + A (m - c + d(m)) in frame 2; d is a wave
along each axis, made of parabolas instead of sines, because only the four basic operations and the square root give
bit-identical results on every machine. Its slope is limited to 1/2, so that T is invertible everywhere.

A motion is stored as one row of `MOTION` float64 values:

    cx cy  tx ty  a b c d (A, row by row)  e f g h (its inverse)
    ax px qx sx  ay py qy sy (d_x = ax w(px x + qx y + sx), ...)
    and two bounding circles of the layer: radius in frame 1, radius in frame 2, centre in frame 2
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiled import inner, njit

MOTION = 24
"""Length of a motion's parameter row."""
_STEPS = 30
_CLOSE = 1e-24
"""Squared step length, in square pixels, below which the inverse has converged."""


@njit(cache=True, nogil=True, inline="always")
def wave(turns: Any) -> Any:
    """Return the value of a wave of period 1 and amplitude 1, made of parabolas with continuous slope: 0 at 0, 1 at
    1/4."""
    u = turns - np.floor(turns + 0.5)
    return 8.0 * u * (1.0 - 2.0 * abs(u))


@njit(cache=True, nogil=True, inline="always")
def _slope(turns: Any) -> Any:
    u = turns - np.floor(turns + 0.5)
    return 8.0 * (1.0 - 4.0 * abs(u))


@njit(cache=True, nogil=True)
def forward(m: Any, x: Any, y: Any) -> Any:
    """Return the position in frame 2 of the point (x, y) of frame 1."""
    u = x - m[0] + m[12] * wave(m[13] * x + m[14] * y + m[15])
    v = y - m[1] + m[16] * wave(m[17] * x + m[18] * y + m[19])
    return m[0] + m[2] + m[4] * u + m[5] * v, m[1] + m[3] + m[6] * u + m[7] * v


@njit(cache=True, nogil=True)
def backward(m: Any, x: Any, y: Any) -> Any:
    """Return the point of frame 1 that is at (x, y) in frame 2, computed by Newton's method up to rounding."""
    u, v = x - m[0] - m[2], y - m[1] - m[3]
    goal_x, goal_y = m[0] + m[8] * u + m[9] * v, m[1] + m[10] * u + m[11] * v
    if m[12] == 0.0 and m[16] == 0.0:
        return goal_x, goal_y
    px, py = goal_x, goal_y
    for _ in range(_STEPS):
        turns_x, turns_y = m[13] * px + m[14] * py + m[15], m[17] * px + m[18] * py + m[19]
        miss_x = px + m[12] * wave(turns_x) - goal_x
        miss_y = py + m[16] * wave(turns_y) - goal_y
        slope_x, slope_y = m[12] * _slope(turns_x), m[16] * _slope(turns_y)
        a, b = 1.0 + slope_x * m[13], slope_x * m[14]
        c, d = slope_y * m[17], 1.0 + slope_y * m[18]
        determinant = a * d - b * c
        step_x = (d * miss_x - b * miss_y) / determinant
        step_y = (a * miss_y - c * miss_x) / determinant
        px -= step_x
        py -= step_y
        if step_x * step_x + step_y * step_y < _CLOSE:
            break
    return px, py


@njit(cache=True, nogil=True, inline="always")
def at_time(m: Any, t: Any, x: Any, y: Any) -> Any:
    """Return the position at time `t` of the point (x, y) of frame 1; frame 2 is at time 1."""
    qx, qy = forward(m, x, y)
    if t != 1.0:
        qx, qy = x + t * (qx - x), y + t * (qy - y)
    return qx, qy


@njit(cache=True, nogil=True, inline="always")
def from_time(m: Any, t: Any, x: Any, y: Any) -> Any:
    """Return the point of frame 1 that is at (x, y) at time `t`, up to rounding."""
    px, py = x, y
    if t == 1.0:
        px, py = backward(m, x, y)
    elif t != 0.0:
        px, py = _newton_time(m, t, x, y)
    return px, py


@inner
def _newton_time(m: Any, t: Any, x: Any, y: Any) -> Any:
    """Compute `from_time` by Newton's method."""
    px, py = x - t * m[2], y - t * m[3]
    for _ in range(_STEPS):
        qx, qy = at_time(m, t, px, py)
        slope_x = m[12] * _slope(m[13] * px + m[14] * py + m[15])
        slope_y = m[16] * _slope(m[17] * px + m[18] * py + m[19])
        xx, xy = 1.0 + slope_x * m[13], slope_x * m[14]
        yx, yy = slope_y * m[17], 1.0 + slope_y * m[18]
        a, b = 1.0 + t * (m[4] * xx + m[5] * yx - 1.0), t * (m[4] * xy + m[5] * yy)
        c, d = t * (m[6] * xx + m[7] * yx), 1.0 + t * (m[6] * xy + m[7] * yy - 1.0)
        determinant = a * d - b * c
        step_x, step_y = (d * (qx - x) - b * (qy - y)) / determinant, (a * (qy - y) - c * (qx - x)) / determinant
        px -= step_x
        py -= step_y
        if step_x * step_x + step_y * step_y < _CLOSE:
            break
    return px, py
