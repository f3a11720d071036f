"""Depth-dependent fog."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.rng import Rng
from ...core.types import Frame, SceneDepth
from ..corruption import DepthCorruption
from .scene import Transmission, transmission, veiled

_CONTRAST = 3.912
"""-ln(0.02), because 2 % of an object's contrast remains at the visibility distance (Koschmieder)."""
_DARKEST, _BRIGHTEST = 175.0, 230.0
_TINT = 6.0
"""Range of the airlight in grey levels, and maximum deviation of red and blue from green, in opposite directions."""


class Fog3d(DepthCorruption):
    """Adds fog of uniform density to both frames, following Koschmieder's law.

    The severity parameter is the meteorological visibility V in metres. A pixel x whose ray is d metres long becomes
    t x + (1 - t) A with t = exp(-3.912 d / V). The airlight A is drawn once per pair: green is between 175 and 230 grey
    levels, and red and blue deviate from it by up to 6 levels in opposite directions, so A is grey with a slightly warm
    or cold tint. As with real fog, the effect is invisible in a room that is only a few metres deep.
    """

    name = "fog_3d"
    paper_severities = (1000.0, 500.0, 250.0, 125.0, 60.0)

    def draw_scene(
        self, rng: Rng, severity: int, depth: SceneDepth
    ) -> tuple[npt.NDArray[np.float32], tuple[Transmission, Transmission]]:
        green, tint = rng.uniform(_DARKEST, _BRIGHTEST), rng.uniform(-_TINT, _TINT)
        density = _CONTRAST / self.parameter(severity)
        first, second = (
            transmission(metres, depth.camera.intrinsics(index), density) for index, metres in enumerate(depth.maps)
        )
        return np.array([green - tint, green, green + tint], np.float32), (first, second)

    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        airlight, transmissions = state
        return veiled(frame, transmissions[index], airlight)
