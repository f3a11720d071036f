"""The content and motion of a pair, drawn from the pair's random stream: layers with a motion (an affine map and a
smooth wave, with an inverse that is exact up to rounding) and an outline (an ellipse or convex polygon with a wobble).

Every point of a layer moves in a straight line at constant speed: at time t it is at m + t (T(m) - m), where m is
its position in frame 1 and T(m) its position in frame 2.

Layer coordinates are coordinates of frame 1. A point m moves to T(m) = c + t + A (m - c + d(m)) in frame 2; d is a wave
along each axis, made of parabolas instead of sines, because only the four basic operations and the square root give
bit-identical results on every machine. Its slope is limited to 1/2, so that T is invertible everywhere.

A motion is stored as one row of `MOTION` float64 values:

    cx cy  tx ty  a b c d (A, row by row)  e f g h (its inverse)
    ax px qx sx  ay py qy sy (d_x = ax w(px x + qx y + sx), ...)
    and two bounding circles of the layer: radius in frame 1, radius in frame 2, centre in frame 2

An outline is stored as one row of `OUTLINE` float64 values:

    cx cy  a b c d (matrix to outline coordinates)  radius  sides  wobble  kx sx ky sy  then nx ny of each side

`sides` is 0 for an ellipse and negative for a background, which covers everything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ....core.compiled import inner, njit
from ....core.rng import Rng
from .textures import SIZE, TextureArray

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


SIDES = 6
"""Maximum number of sides of a polygon."""
OUTLINE = 13 + 2 * SIDES
"""Length of an outline's parameter row."""


@njit(cache=True, nogil=True)
def inset(o: Any, x: Any, y: Any) -> Any:
    """Return the approximate distance, in pixels, of a point of frame 1 from the outline: positive inside, negative
    outside, infinite for a background."""
    if o[7] < 0.0:
        return np.inf
    x, y = x - o[0], y - o[1]
    u, v = o[2] * x + o[3] * y, o[4] * x + o[5] * y
    u, v = u + o[8] * wave(o[9] * v + o[10]), v + o[8] * wave(o[11] * u + o[12])
    sides = int(o[7])
    if sides == 0:
        reach = np.sqrt(u * u + v * v)
    else:
        reach = -np.inf
        for side in range(sides):
            reach = max(reach, o[13 + 2 * side] * u + o[14 + 2 * side] * v)
    return (1.0 - reach) * o[6]


Numbers = npt.NDArray[np.float64]

_LAYERS = (4, 13)
"""Range of the number of shapes in front of the background; the upper bound is exclusive."""
_REFERENCE = math.sqrt(384 * 512)
"""Reference size, in pixels: lengths are drawn for frames of FlyingChairs' size and scaled by the square root of the
area."""
_BACKGROUND_SHIFT, _SHIFT = 7.0, 10.0
"""Translation at one standard deviation, in pixels at the reference size; a few translations are much longer (see
`_spread`)."""
_FOLLOWS = 0.6
"""Probability that a shape moves with the background in addition to its own motion, like objects that a moving camera
passes."""
_WAVES = 0.5
"""Probability of a non-rigid motion."""
_STEEPEST = 0.2
"""Maximum slope of a wave; for an invertible motion, the sum over both axes must be below 1."""
_UNEVEN = 0.1
"""Maximum rotation of a polygon's side, as a fraction of the angle between two sides."""
_GAIN, _OFFSET = (0.6, 1.3), 40.0


@dataclass(frozen=True, eq=False)
class Scene:
    """The layers of a pair from front to back; the last layer is the background."""

    shape: tuple[int, int]
    motions: Numbers
    outlines: Numbers
    fills: Numbers
    chosen: npt.NDArray[np.int64]
    textures: TextureArray


def draw_scene(rng: Rng, shape: tuple[int, int], motion: float, textures: TextureArray) -> Scene:
    height, width = shape
    unit = math.sqrt(height * width) / _REFERENCE
    shift = (_shift(rng, _BACKGROUND_SHIFT * unit * motion), _shift(rng, _BACKGROUND_SHIFT * unit * motion))
    layers = []
    for _ in range(rng.integer(*_LAYERS)):
        centre = (rng.uniform(-0.1, 1.1) * width, rng.uniform(-0.1, 1.1) * height)
        outline, reach = _outline(rng, centre, unit)
        own = (_shift(rng, _SHIFT * unit * motion), _shift(rng, _SHIFT * unit * motion))
        follows = rng.uniform() < _FOLLOWS
        moved = (own[0] + follows * shift[0], own[1] + follows * shift[1])
        layers.append((_motion(rng, centre, moved, reach, strength=1.0), outline, _fill(rng)))
    middle = (0.5 * width, 0.5 * height)
    background = np.zeros(OUTLINE)
    background[7] = -1.0
    layers.append((_motion(rng, middle, shift, 0.5 * _length(*shape), strength=0.5), background, _fill(rng)))
    motions, outlines, fills = (np.stack(part) for part in zip(*layers, strict=True))
    chosen = np.array([rng.integer(0, len(textures)) for _ in layers])
    return Scene(shape, motions, outlines, fills, chosen, textures)


def _spread(rng: Rng) -> float:
    """Draw a standard normal number and raise its magnitude to the power 1.5, keeping the sign, which gives many small
    and a few large values."""
    number = float(rng.normals(1)[0])
    return number * math.sqrt(abs(number))


def _shift(rng: Rng, scale: float) -> float:
    return scale * _spread(rng)


def _turn(half_tangent: float) -> tuple[float, float]:
    """Draw the cosine and sine of an angle through its half-angle tangent, avoiding functions that differ between
    machines."""
    square = half_tangent * half_tangent
    return (1.0 - square) / (1.0 + square), 2.0 * half_tangent / (1.0 + square)


def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


def _motion(
    rng: Rng, centre: tuple[float, float], shift: tuple[float, float], reach: float, strength: float
) -> Numbers:
    """Draw a layer's motion; `strength` scales the rotation and zoom about the layer's centre."""
    cosine, sine = _turn(0.04 * strength * _spread(rng))
    zoom = max(1.0 + 0.04 * strength * _spread(rng), 0.7)
    stretch = max(1.0 + 0.015 * strength * _spread(rng), 0.8)
    matrix = np.array([[zoom * cosine, -stretch * zoom * sine], [zoom * sine, stretch * zoom * cosine]])
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    (a, b), (c, d) = matrix
    inverse = np.array([d, -b, -c, a]) / determinant
    waves: list[float] = []
    highest = 0.0
    waving = rng.uniform() < _WAVES
    for _ in range(2):
        cosine, sine = _turn(rng.uniform(-1.0, 1.0))
        length = max(reach, 8.0) * rng.uniform(1.0, 3.0)
        height = waving * length * _STEEPEST / 8.0 * rng.uniform()
        highest = max(highest, height)
        waves += [height, cosine / length, sine / length, rng.uniform()]
    largest = 1.000001 * zoom * max(stretch, 1.0) * (reach + _length(highest, highest))
    moved = (centre[0] + shift[0], centre[1] + shift[1])
    numbers = [*centre, *shift, *matrix.ravel(), *inverse, *waves, reach, largest, *moved]
    assert len(numbers) == MOTION
    return np.array(numbers, np.float64)


def _outline(rng: Rng, centre: tuple[float, float], unit: float) -> tuple[Numbers, float]:
    """Draw an outline, and return it with the radius of its bounding circle, including the soft border."""
    size = unit * (14.0 + 150.0 * rng.uniform() ** 2)
    long, short = size, max(size * max(math.sqrt(rng.uniform()), 0.12), 1.5)
    cosine, sine = _turn(rng.uniform(-1.0, 1.0))
    wobble = rng.uniform(0.0, 0.2)
    sides = rng.integer(0, SIDES + 1)
    sides = sides if sides >= 3 else 0
    normals, reach = np.zeros((SIDES, 2)), 1.0
    if sides:
        step, turn = 2.0 * math.pi / sides, rng.uniform(0.0, 2.0 * math.pi)
        for side in range(sides):
            angle = turn + step * (side + _UNEVEN * rng.uniform(-1.0, 1.0))
            normals[side] = round(math.cos(angle), 9), round(math.sin(angle), 9)  # libm may differ in the last bit
        reach = 1.0 / math.cos((0.5 + _UNEVEN) * step)
    rows = [cosine / long, sine / long, -sine / short, cosine / short]
    numbers = [*centre, *rows, short, float(sides), wobble]
    for _ in range(2):
        numbers += [rng.uniform(0.3, 0.9), rng.uniform()]
    numbers += normals.ravel().tolist()
    assert len(numbers) == OUTLINE
    return np.array(numbers, np.float64), (reach + 1.5 * wobble + 0.5 / short) * long + 0.01


def _fill(rng: Rng) -> Numbers:
    cosine, sine = _turn(rng.uniform(-1.0, 1.0))
    scale = rng.uniform(0.4, 1.2)
    across = [scale * cosine, scale * sine, rng.uniform(0.0, SIZE)]
    down = [-scale * sine, scale * cosine, rng.uniform(0.0, SIZE)]
    gain = [rng.uniform(*_GAIN) for _ in range(3)]
    offset = rng.uniform(-_OFFSET, _OFFSET)
    return np.array([*across, *down, *gain, *(128.0 * (1.0 - value) + offset for value in gain)])
