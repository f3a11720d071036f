"""Generate frost textures for the benchmark `demo`, which requires no downloads: fern-like crystals on a cloudy pane.

The five textures match the photographs in mean, standard deviation and scale. They use separate random streams, so
their bytes are identical on every machine and for every benchmark seed. They differ from the paper's textures, so the
results are kept separate from those measured with the photographs.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.rng import Rng
from ...core.types import Frame
from ..kernels.fields import plasma_corner
from .frost import Frost

SHAPE = (500, 750)
"""Size (H, W) of every texture, in pixels."""

_STEMS = 6
_SIXTIETH = (0.5, 0.8660254037844386)
"""Cosine and sine of 60 degrees, the angle between the branches of ice crystals."""
_CLOUDS = 0.55
"""Weight of the cloudy pane in the texture; the remaining weight is that of the crystals."""


class TextureStyle(NamedTuple):
    """Parameters of a texture, matched to the photograph in the same slot."""

    mean: float
    """Mean, in grey levels."""
    spread: float
    """Standard deviation, in grey levels."""
    tint: tuple[float, float, float]
    """Factors applied to red, green and blue."""
    crystals: int
    length: int
    """Length of a stem, in pixels."""
    spacing: int
    """Distance between the branches of a stem, in pixels."""


STYLES = (
    TextureStyle(128.0, 22.0, (0.82, 1.03, 1.15), 500, 36, 5),
    TextureStyle(205.0, 22.0, (0.98, 1.0, 1.02), 420, 60, 7),
    TextureStyle(190.0, 26.0, (0.97, 1.0, 1.03), 900, 30, 4),
    TextureStyle(152.0, 29.0, (0.91, 1.0, 1.09), 1100, 24, 4),
    TextureStyle(122.0, 43.0, (0.92, 1.0, 1.08), 700, 40, 4),
)


@lru_cache(maxsize=5)
def generated_texture(slot: int) -> Frame:
    """Generate texture `slot` (0 to 4), RGB uint8 (500, 750, 3)."""
    style, rng = STYLES[slot], Rng.of("robustflow", "generated frost", 1, slot)
    clouds = _standardised(plasma_corner(rng.spawn("clouds"), *SHAPE, 1.7).astype(np.float64))
    ice = _crystals(rng.spawn("crystals"), style)
    ice = _standardised(ice / (1.0 + np.abs(ice)))  # limits the brightness of overlapping crystals
    grey = _standardised(_CLOUDS * clouds + (1.0 - _CLOUDS) * ice) * style.spread + style.mean
    return np.clip(np.rint(grey[..., None] * np.array(style.tint)), 0, 255).astype(np.uint8)


class GeneratedFrost(Frost):
    """A frost corruption that uses the generated textures."""

    texture = staticmethod(generated_texture)


def _crystals(rng: Rng, style: TextureStyle) -> npt.NDArray[np.float64]:
    """Compute the shading of all crystals, float64 (H, W); each has six stems with branches at 60 degrees on both
    sides.
    """
    count = style.crystals
    height, width = SHAPE
    y0, x0 = height * rng.uniforms(count), width * rng.uniforms(count)
    along = _directions(rng, count)
    stems = np.stack([_turned(along, place) for place in range(_STEMS)], axis=1)  # (crystal, stem, 2)
    sizes = 0.3 + 0.7 * rng.uniforms(count * _STEMS).reshape(count, _STEMS)
    light = 0.5 + rng.uniforms(count)
    knots = np.arange(style.spacing, style.length, style.spacing)
    out = np.zeros(height * width)
    steps = np.arange(style.length)
    for stem in range(_STEMS):
        ray, size = stems[:, stem], sizes[:, stem]
        reach = np.where(steps[None] < size[:, None] * style.length, light[:, None], 0.0)
        _splat(out, y0[:, None] + ray[:, 1:] * steps, x0[:, None] + ray[:, :1] * steps, reach)
        for side, shade in ((1, 0.9), (-1, -0.7)):  # the light comes from one side
            twig = _turned(ray, side)
            for knot in knots:
                length = 0.45 * (size * style.length - knot)
                inner = np.arange(1, max(2, style.length // 2))
                weight = np.where(inner[None] < length[:, None], shade * light[:, None], 0.0)
                y = y0[:, None] + ray[:, 1:] * knot + twig[:, 1:] * inner
                x = x0[:, None] + ray[:, :1] * knot + twig[:, :1] * inner
                _splat(out, y, x, weight)
    return out.reshape(SHAPE)


def _directions(rng: Rng, count: int) -> npt.NDArray[np.float64]:
    """Return random unit vectors (x, y), float64 (count, 2), using only square roots, which are identical on every
    machine.
    """
    across = np.stack([rng.uniforms(count) - 0.5, rng.uniforms(count) - 0.5], axis=1)
    across[:, 0] += np.where(across[:, 0] < 0, -0.01, 0.01)
    return across / np.sqrt(across[:, :1] * across[:, :1] + across[:, 1:] * across[:, 1:])


def _turned(ray: npt.NDArray[np.float64], sixths: int) -> npt.NDArray[np.float64]:
    """Rotate vectors by multiples of 60 degrees."""
    cosine, sine = _SIXTIETH
    for _ in range(sixths % _STEMS):
        ray = np.stack([cosine * ray[:, 0] - sine * ray[:, 1], sine * ray[:, 0] + cosine * ray[:, 1]], axis=1)
    return ray


def _splat(out: npt.NDArray[np.float64], y: npt.NDArray[np.float64], x: npt.NDArray[np.float64],
           weight: npt.NDArray[np.float64]) -> None:  # fmt: skip
    """Add points to the four surrounding pixels with bilinear weights, wrapping around at the borders."""
    height, width = SHAPE
    drawn = weight != 0
    y, x, weight = y[drawn], x[drawn], weight[drawn]
    top, left = np.floor(y), np.floor(x)
    down, right = y - top, x - left
    rows, columns = top.astype(np.int64), left.astype(np.int64)
    for dy, vertical in ((0, 1.0 - down), (1, down)):
        for dx, horizontal in ((0, 1.0 - right), (1, right)):
            place = (rows + dy) % height * width + (columns + dx) % width
            out += np.bincount(place, weight * vertical * horizontal, height * width)


def _standardised(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Normalise values to mean 0 and standard deviation 1 using integer sums, which do not depend on the order."""
    whole = np.rint(values * 2.0**20).astype(np.int64)
    mean = int(whole.sum()) / whole.size
    squares = int(((whole >> 8) ** 2).sum()) * 2.0**16
    spread = np.sqrt(squares / whole.size - mean * mean)
    return (whole - mean) / spread
