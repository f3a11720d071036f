"""Fog that thickens with distance."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...images.contiguous import contiguous
from ...random.rng import Rng
from ...sample import DepthMap, Frame, SceneDepth
from ..base import DepthCorruption

Transmission = npt.NDArray[np.float32]
"""float32 (H, W) in (0, 1]: the share of an object's light that arrives."""

_CONTRAST = 3.912
"""-ln(0.02): at the visibility, an object keeps 2 % of its contrast (Koschmieder)."""
_DARKEST, _BRIGHTEST = 175.0, 230.0
_TINT = 6.0
"""Grey levels of the airlight, and how far red and blue may be from its green, in opposite directions."""
_STEPS, _THICKEST = 256, 16
"""Steps of the table for each unit of optical thickness, and the thickness beyond which nothing is left to see."""


class Fog3d(DepthCorruption):
    """Fog of a uniform density: Koschmieder's law by the depth of every pixel, in both frames.

    A severity is the meteorological visibility V in metres. With Z the depth in metres, t = exp(-3.912 Z / V) and
    out = t x + (1 - t) A. The airlight A is drawn once for the pair: a green of 175 to 230 grey levels, with red and
    blue up to 6 levels from it in opposite directions, so that it is a near-grey between warm and cold.
    In a room of a few metres this fog is invisible, as fog is.
    """

    name = "fog_3d"
    family = "depth"
    paper_severities = (1000.0, 500.0, 250.0, 125.0, 60.0)

    def draw_scene(
        self, rng: Rng, severity: int, depth: SceneDepth
    ) -> tuple[npt.NDArray[np.float32], tuple[Transmission, Transmission]]:
        """(the airlight, the transmission of both frames)."""
        green, tint = rng.uniform(_DARKEST, _BRIGHTEST), rng.uniform(-_TINT, _TINT)
        density = _CONTRAST / self.parameter(severity)
        first, second = (_transmission(one, density) for one in depth.maps)
        return np.array([green - tint, green, green + tint], np.float32), (first, second)

    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        """Put the fog over one frame."""
        airlight, transmissions = state
        frame = contiguous(frame)
        out = np.empty_like(frame)
        _blend(frame, transmissions[index], airlight, out)
        return out


def _transmission(depth: DepthMap, density: float) -> Transmission:
    out = np.empty_like(depth)
    _look_up(np.ascontiguousarray(depth), np.float32(density * _STEPS), _decay(), out)
    return out


@cache
def _decay() -> npt.NDArray[np.float32]:
    """exp(-i / 256), without the machine's own exponential, whose last bit differs between machines: a Taylor series of
    the 64th part, squared six times."""
    x = np.arange(_STEPS * _THICKEST + 2) / (-64.0 * _STEPS)
    total = term = np.ones_like(x)
    for order in range(1, 12):
        term = term * x / order
        total = total + term
    for _ in range(6):
        total = total * total
    return total.astype(np.float32)


@njit(cache=True, nogil=True)
def _look_up(depth: Any, scale: Any, table: Any, out: Any) -> None:
    last = np.float32(table.shape[0] - 2)
    for y in range(depth.shape[0]):
        source, target = depth[y], out[y]
        for x in range(source.shape[0]):
            place = min(source[x] * scale, last)
            below = np.int32(place)
            part = place - np.float32(below)
            target[x] = table[below] + part * (table[below + 1] - table[below])


@njit(cache=True, nogil=True)
def _blend(frame: Any, transmission: Any, airlight: Any, out: Any) -> None:
    red, green, blue = airlight
    for y in range(frame.shape[0]):
        source, target, row = frame[y], out[y], transmission[y]
        for x in range(row.shape[0]):
            share = row[x]
            rest = np.float32(1) - share
            target[x, 0] = np.uint8(np.rint(share * np.float32(source[x, 0]) + rest * red))
            target[x, 1] = np.uint8(np.rint(share * np.float32(source[x, 1]) + rest * green))
            target[x, 2] = np.uint8(np.rint(share * np.float32(source[x, 2]) + rest * blue))
