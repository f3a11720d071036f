"""Add fog."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.rng import Rng
from ...core.types import Frame
from ..corruption import Corruption
from ..kernels.fields import plasma_corner

FogMap = npt.NDArray[np.float32]
"""A fog map, float32 (H, W) in [0, 1]."""


class FogLevel(NamedTuple):
    strength: float  # strength c of the fog
    decay: float  # decay of the fractal; higher values result in smoother fog


class Fog(Corruption):
    """Adds a plasma fractal to both frames and reduces the contrast (paper, appendix, weather).

    The severity parameters are (strength c, decay of the fractal); the values are from the reference code, since the
    paper does not list any. out = (x + c * map) * m / (m + c) in [0, 1], where m is the maximum value of the frame.
    Both frames share the same map.
    """

    name = "fog"
    level = FogLevel
    paper_severities = ((1.5, 2.0), (2.0, 2.0), (2.5, 1.7), (2.5, 1.5), (3.0, 1.4))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, FogMap]:
        fog: FogLevel = self.parameter(severity)
        return float(fog.strength), plasma_corner(rng, *shape, fog.decay)

    def apply(self, frame: Frame, state: tuple[float, FogMap], index: int) -> Frame:
        strength, fog = state
        frame = contiguous(frame)
        rows = frame.reshape(len(frame), -1)
        brightest = float(frame.max()) / 255
        gain = brightest / (brightest + strength)
        out = np.empty_like(rows)
        added = np.empty(rows.shape[1], np.float32)
        _blend(rows, fog, np.float32(gain), np.float32(gain * strength * 255), added, out)
        return out.reshape(frame.shape)


@njit(cache=True, nogil=True)
def _blend(rows: Any, fog: Any, gain: Any, strength: Any, added: Any, out: Any) -> None:
    """Compute gain * rows + strength * fog, at most 255 because gain * (1 + strength / brightest) is 1."""
    height, width = fog.shape
    for y in range(height):
        layer = fog[y]
        for x in range(width):
            added[3 * x] = added[3 * x + 1] = added[3 * x + 2] = strength * layer[x]
        source, target = rows[y], out[y]
        for i in range(3 * width):
            target[i] = np.uint8(np.rint(min(gain * np.float32(source[i]) + added[i], np.float32(255))))
