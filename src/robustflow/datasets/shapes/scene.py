"""What a pair shows and how it moves: every number is drawn from the pair's own stream."""

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
"""Number of shapes over the background: from, and below."""
_REFERENCE = math.sqrt(384 * 512)
"""Pixels: lengths are drawn for frames of FlyingChairs' size and scaled with the square root of the area."""
_BACKGROUND_SHIFT, _SHIFT = 7.0, 10.0
"""Pixels at that size, of a draw of one standard deviation; a few are much longer (see `_spread`)."""
_FOLLOWS = 0.6
"""Probability that a shape moves with the background in addition to its own motion, like things that a camera
passes."""
_WAVES = 0.5
"""Probability of a non-rigid motion."""
_STEEPEST = 0.2
"""Largest slope of a wave; the inverse of a motion needs the sum of both axes below 1."""
_UNEVEN = 0.1
"""The share of the angle between two sides of a polygon by which one may be turned."""
_GAIN, _OFFSET = (0.6, 1.3), 40.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Layers from front to back; the last one is the background.

    Attributes:
        shape: (H, W).
        motions, outlines: a row of numbers for each layer, see `motion` and `outline`.
        fills: for each layer, where its texture is taken from (two rows of an affine map from pixels to texels), then
            gain and offset of each channel.
        chosen: the index of each layer's texture.
        textures: to choose from.
    """

    shape: tuple[int, int]
    motions: Numbers
    outlines: Numbers
    fills: Numbers
    chosen: npt.NDArray[np.int64]
    textures: TextureArray


def draw_scene(rng: Rng, shape: tuple[int, int], motion: float, textures: TextureArray) -> Scene:
    """A scene.

    Args:
        rng: the pair's stream.
        shape: (H, W).
        motion: factor on all translations.
        textures: to choose from.
    """
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
    """A standard normal number raised to the power 1.5, with its sign: many small values, some large ones."""
    number = float(rng.normals(1)[0])
    return number * math.sqrt(abs(number))


def _shift(rng: Rng, scale: float) -> float:
    return scale * _spread(rng)


def _turn(half_tangent: float) -> tuple[float, float]:
    """Cosine and sine of an angle by the tangent of its half: without functions that differ between machines."""
    square = half_tangent * half_tangent
    return (1.0 - square) / (1.0 + square), 2.0 * half_tangent / (1.0 + square)


def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


def _motion(
    rng: Rng, centre: tuple[float, float], shift: tuple[float, float], reach: float, strength: float
) -> Numbers:
    """A layer's motion; rotation and zoom by `strength`, about its centre."""
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
    numbers = [
        *centre,
        *shift,
        a,
        b,
        c,
        d,
        *inverse,
        *waves,
        reach,
        largest,
        centre[0] + shift[0],
        centre[1] + shift[1],
    ]
    assert len(numbers) == MOTION
    return np.array(numbers, np.float64)


def _outline(rng: Rng, centre: tuple[float, float], unit: float) -> tuple[Numbers, float]:
    """An outline, and the radius of a circle about its centre that holds it with its soft border."""
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
    """Where a layer takes its texture from, and its colours."""
    cosine, sine = _turn(rng.uniform(-1.0, 1.0))
    scale = rng.uniform(0.4, 1.2)
    place = [
        scale * cosine,
        scale * sine,
        rng.uniform(0.0, SIZE),
        -scale * sine,
        scale * cosine,
        rng.uniform(0.0, SIZE),
    ]
    gain = [rng.uniform(*_GAIN) for _ in range(3)]
    offset = rng.uniform(-_OFFSET, _OFFSET)
    return np.array([*place, *gain, *(128.0 * (1.0 - value) + offset for value in gain)])
