"""The content and motion of a pair; all values are drawn from the pair's random stream."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...random.rng import Rng
from .motion import MOTION
from .outline import OUTLINE, SIDES
from .textures import SIZE, TextureArray

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
    """Draw a scene."""
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
    """Draw the texture coordinates and colours of a layer."""
    cosine, sine = _turn(rng.uniform(-1.0, 1.0))
    scale = rng.uniform(0.4, 1.2)
    across = [scale * cosine, scale * sine, rng.uniform(0.0, SIZE)]
    down = [-scale * sine, scale * cosine, rng.uniform(0.0, SIZE)]
    gain = [rng.uniform(*_GAIN) for _ in range(3)]
    offset = rng.uniform(-_OFFSET, _OFFSET)
    return np.array([*across, *down, *gain, *(128.0 * (1.0 - value) + offset for value in gain)])
