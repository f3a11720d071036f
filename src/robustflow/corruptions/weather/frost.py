"""Frost."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiled import njit
from ...images.contiguous import contiguous
from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from .frost_assets import TEXTURES
from .frost_textures import enlarged_shape, enlarged_texture, photograph


class FrostState(NamedTuple):
    """Where the layer is cut from; the picture itself stays in the cache."""

    slot: int
    """Texture, 0 to 4."""
    top: int
    left: int
    shape: tuple[int, int]
    keep: float
    """Share of the frame."""
    add: float
    """Share of the frost."""


class FrostLevel(NamedTuple):
    """A severity: out = keep * frame + add * frost."""

    keep: float
    add: float


class Frost(Corruption):
    """A photograph of frost over both frames: out = a * x + b * frost (paper, appendix, weather).

    A severity is (a, b); the numbers are the reference code's, the paper gives none. One of five textures (two of
    which are the same picture; the library's sixth is never drawn) is enlarged to 1.1 times the size that covers the
    frame, and cut at a random place: one cut for the pair.

    The textures belong to the package `imagecorruptions` and are fetched on first use: see frost_assets.

    Raises:
        AssetError: from `draw` and `apply`, when the textures are not there and cannot be fetched.
    """

    name = "frost"
    family = "weather"
    level = FrostLevel
    paper_severities = ((1.0, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75))

    texture = staticmethod(photograph)
    """Return texture 0 to 4, RGB uint8."""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> FrostState:
        """The texture and the place it is cut at."""
        level: FrostLevel = self.parameter(severity)
        slot = rng.integer(0, len(TEXTURES))
        height, width = enlarged_shape(self.texture, slot, shape)
        top, left = rng.integer(0, height - shape[0]), rng.integer(0, width - shape[1])
        return FrostState(slot, top, left, (shape[0], shape[1]), level.keep, level.add)

    def apply(self, frame: Frame, state: FrostState, index: int) -> Frame:
        """Put the frost over one frame."""
        height, width = state.shape
        frost = enlarged_texture(self.texture, state.slot, state.shape)
        source = contiguous(frame).reshape(height, 3 * width)
        out = np.empty_like(source)
        keep, add = np.float32(state.keep), np.float32(state.add)
        _blend(source, frost.reshape(len(frost), -1), state.top, 3 * state.left, keep, add, out)
        return out.reshape(frame.shape)


@njit(cache=True, nogil=True)
def _blend(frame: Any, frost: Any, top: int, left: int, keep: Any, add: Any, out: Any) -> None:
    height, n = frame.shape
    for y in range(height):
        source, layer, target = frame[y], frost[top + y][left : left + n], out[y]
        for i in range(n):
            value = keep * np.float32(source[i]) + add * np.float32(layer[i])
            target[i] = np.uint8(np.rint(min(value, np.float32(255))))
