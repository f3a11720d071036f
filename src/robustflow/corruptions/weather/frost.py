"""Add frost: photographs, or generated textures for the benchmark `demo`, which requires no downloads.

The five generated textures show fern-like crystals on a cloudy pane and match the photographs in mean, standard
deviation and scale. They use separate random streams, so their bytes are identical on every machine and for every
benchmark seed. They differ from the paper's textures, so the results are kept separate from those measured with the
photographs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.errors import AssetError
from ...core.rng import Rng
from ...core.types import Frame
from ..corruption import Corruption
from ..kernels.cache import BytesCache
from ..kernels.fields import plasma_corner
from .frost_photographs import TEXTURES, read_texture

Texture = Callable[[int], Frame]
"""A function that returns texture 0 to 4 as RGB uint8 (H, W, 3)."""

_KEPT_BYTES = 128 << 20
"""Size limit of the cache of enlarged textures: sufficient for all textures at a few KITTI frame sizes, or for three
textures at 4K.
"""
_MARGIN = 1.1

_enlarged = BytesCache(_KEPT_BYTES)


@lru_cache(maxsize=len(TEXTURES))
def photograph(slot: int) -> Frame:
    """Return the original texture `slot` (0 to 4), RGB uint8."""
    encoded = np.frombuffer(read_texture(slot), np.uint8)
    decoded = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    if decoded is None:
        raise AssetError(
            f"OpenCV cannot decode frost texture {list(TEXTURES)[slot]}; install a build with PNG and JPEG support"
        )
    return np.ascontiguousarray(decoded[..., ::-1])


def enlarged_shape(texture: Texture, slot: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the size (H, W) of the enlarged texture for frames of `shape`."""
    height, width = texture(slot).shape[:2]
    scale = max(1.0, shape[0] / height, shape[1] / width) * _MARGIN
    return int(np.ceil(height * scale)), int(np.ceil(width * scale))


def enlarged_texture(texture: Texture, slot: int, shape: tuple[int, int]) -> Frame:
    """Return the texture, RGB uint8, enlarged for frames of `shape` (H, W); results are cached."""
    large = enlarged_shape(texture, slot, shape)
    enlarged: Frame = _enlarged.get((texture, slot, *large), lambda: resize_cubic(texture(slot), large))
    return enlarged


def resize_cubic(image: Frame, shape: tuple[int, int]) -> Frame:
    """Resize by cubic convolution (a = -0.75, edges repeated, pixel centres aligned), like OpenCV's INTER_CUBIC."""
    rows, row_weights = _taps(image.shape[0], shape[0])
    columns, column_weights = _taps(image.shape[1], shape[1])
    out = np.empty((*shape, 3), np.uint8)
    lines = image.reshape(len(image), -1)
    _resize(lines, rows, row_weights, columns, column_weights, np.empty(lines.shape[1], np.float32), out)
    return out


def _taps(source: int, target: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """Return, for each target pixel, the indices and weights of its source pixels: int64 and float32 (target, 4)."""
    at = (np.arange(target) + 0.5) * (source / target) - 0.5
    left = np.floor(at)
    t, a = at - left, -0.75
    near = [((a + 2) * d - (a + 3)) * d * d + 1 for d in (t, 1 - t)]
    far = [((a * d - 5 * a) * d + 8 * a) * d - 4 * a for d in (t + 1, 2 - t)]
    weights = np.stack([far[0], near[0], near[1], far[1]], axis=1).astype(np.float32)
    index = left.astype(np.int64)[:, None] + np.arange(-1, 3)
    return np.clip(index, 0, source - 1), weights


@njit(cache=True, nogil=True)
def _resize(image: Any, rows: Any, row_weights: Any, columns: Any, column_weights: Any, line: Any, out: Any) -> None:
    """Resize (h, w, 3) to (H, W, 3) bicubically; the order of the sums fixes their bits."""
    for y in range(out.shape[0]):
        a, b = image[rows[y, 0]], image[rows[y, 1]]
        c, d = image[rows[y, 2]], image[rows[y, 3]]
        w = row_weights[y]
        for i in range(line.size):
            inner = w[1] * np.float32(b[i]) + w[2] * np.float32(c[i])
            line[i] = inner + (w[0] * np.float32(a[i]) + w[3] * np.float32(d[i]))
        for x in range(out.shape[1]):
            v = column_weights[x]
            for k in range(3):
                inner = v[1] * line[3 * columns[x, 1] + k] + v[2] * line[3 * columns[x, 2] + k]
                value = inner + (v[0] * line[3 * columns[x, 0] + k] + v[3] * line[3 * columns[x, 3] + k])
                out[y, x, k] = np.uint8(np.rint(min(max(value, np.float32(0)), np.float32(255))))


class FrostState(NamedTuple):
    """Texture and position of the frost crop; the texture itself remains in the cache."""

    slot: int  # index of the texture, 0 to 4
    top: int
    left: int
    shape: tuple[int, int]
    keep: float  # weight of the frame
    add: float  # weight of the frost


class FrostLevel(NamedTuple):
    """Parameters for one severity: out = keep * frame + add * frost."""

    keep: float
    add: float


class Frost(Corruption):
    """Blends both frames with a photograph of frost: out = a * x + b * frost (paper, appendix, weather).

    The severity parameters are (a, b); the values are from the reference code, since the paper does not list any.
    One of five textures (two of which show the same photograph; the sixth texture of `imagecorruptions` is never
    used) is enlarged to 1.1 times the size that covers the frame and cropped at a random position, which is shared by
    both frames.

    The textures are part of the package `imagecorruptions` and are downloaded on first use; see frost_photographs.

    Raises:
        AssetError: the textures are missing and cannot be downloaded (raised by `draw` and `apply`).
    """

    name = "frost"
    level = FrostLevel
    paper_severities = ((1.0, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75))

    texture = staticmethod(photograph)
    """Return texture 0 to 4, RGB uint8."""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> FrostState:
        level: FrostLevel = self.parameter(severity)
        slot = rng.integer(0, len(TEXTURES))
        height, width = enlarged_shape(self.texture, slot, shape)
        top, left = rng.integer(0, height - shape[0]), rng.integer(0, width - shape[1])
        return FrostState(slot, top, left, (shape[0], shape[1]), level.keep, level.add)

    def apply(self, frame: Frame, state: FrostState, index: int) -> Frame:
        height, width = state.shape
        frost = enlarged_texture(self.texture, state.slot, state.shape)
        source = contiguous(frame).reshape(height, 3 * width)
        out = np.empty_like(source)
        keep, add = np.float32(state.keep), np.float32(state.add)
        _blend(source, frost.reshape(len(frost), -1), state.top, 3 * state.left, keep, add, out)
        return out.reshape(frame.shape)


@njit(cache=True, nogil=True)
def _blend(frame: Any, frost: Any, top: int, left: int, keep: Any, add: Any, out: Any) -> None:
    """Mix rows (H, 3 W) with a cut of the texture: `keep` and `add` are the shares."""
    height, n = frame.shape
    for y in range(height):
        source, layer, target = frame[y], frost[top + y][left : left + n], out[y]
        for i in range(n):
            value = keep * np.float32(source[i]) + add * np.float32(layer[i])
            target[i] = np.uint8(np.rint(min(value, np.float32(255))))


SHAPE = (500, 750)
"""Size (H, W) of every texture, in pixels."""

_STEMS = 6
_SIXTIETH = (0.5, 0.8660254037844386)
"""Cosine and sine of 60 degrees, the angle between the branches of ice crystals."""
_CLOUDS = 0.55
"""Weight of the cloudy pane in the texture; the remaining weight is that of the crystals."""


class TextureStyle(NamedTuple):
    """Parameters of a texture, matched to the photograph in the same slot."""

    mean: float  # mean, in grey levels
    spread: float  # standard deviation, in grey levels
    tint: tuple[float, float, float]  # factors applied to red, green and blue
    crystals: int
    length: int  # length of a stem, in pixels
    spacing: int  # distance between the branches of a stem, in pixels


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
    cosine, sine = _SIXTIETH
    for _ in range(sixths % _STEMS):
        ray = np.stack([cosine * ray[:, 0] - sine * ray[:, 1], sine * ray[:, 0] + cosine * ray[:, 1]], axis=1)
    return ray


def _splat(
    out: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    x: npt.NDArray[np.float64],
    weight: npt.NDArray[np.float64],
) -> None:
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
