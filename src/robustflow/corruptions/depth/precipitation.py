"""Base class for rain and snow: particles and a veil in both frames. Rain as particles in the 3D scene. Snow as
particles in the 3D scene.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ...core.compiled import njit
from ...core.rng import Rng
from ...core.types import DepthMap, Frame, SceneDepth
from ..base import DepthCorruption
from .particles import Fall, Particles, Sizes, draw_particles, streaks_of, veil_of
from .scene import transmission, veiled


class PrecipitationState(NamedTuple):
    """State for a pair: the particles, their veil, and the depth of the scene."""

    particles: Particles
    depth: tuple[DepthMap, DepthMap]
    """Depth maps of both frames, in metres."""
    veil: tuple[float, float]
    """Veil formed by small particles: (extinction coefficient in 1/m, start distance in metres)."""


class Precipitation(DepthCorruption):
    """Adds particles of a single colour, each of which hides the background for a fraction of the exposure.

    A particle that covers a pixel for a fraction a of the exposure changes the pixel x to (1 - a) x + a * colour; for a
    particle of diameter 2 r and a streak of length L, a is 2 r / L. A particle is drawn as a disk with a soft edge as
    wide as the blur caused by the lens and the pixel at that depth; however small the particle is, its weights
    over all pixels have the same sum as those of a sharp disk. Pixels closer than the particle are unchanged.
    """

    colour: ClassVar[tuple[float, float, float]]
    fall: ClassVar[Fall]

    @abstractmethod
    def sizes(self, rate: float) -> Sizes:
        """Return the particle size distribution for a rate in mm of water per hour."""

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> PrecipitationState:
        """Sample the particles."""
        sizes, shape = self.sizes(self.parameter(severity)), depth.maps[0].shape
        particles = draw_particles(rng, sizes, self.fall, shape, depth.camera)
        return PrecipitationState(particles, depth.maps, veil_of(sizes, shape, depth.camera))

    def apply(self, frame: Frame, state: PrecipitationState, index: int) -> Frame:
        """Add the particles and the veil to frame `index`, 0 or 1."""
        depth = np.ascontiguousarray(state.depth[index])
        density, start = state.veil
        passed = transmission(depth, state.particles.lenses[index], density, start)
        _cover(streaks_of(state.particles, index), depth, passed)
        return veiled(frame, passed, np.array(self.colour, np.float32))


@njit(cache=True, nogil=True, error_model="numpy")
def _cover(streaks: Any, depth: Any, passed: Any) -> None:
    """Multiply `passed` by the fraction of light that each streak transmits at each pixel."""
    height, width = depth.shape
    for i in range(len(streaks)):
        x0, y0, dx, dy = streaks[i, 0], streaks[i, 1], streaks[i, 2] - streaks[i, 0], streaks[i, 3] - streaks[i, 1]
        z, radius, soft = streaks[i, 4], streaks[i, 5], streaks[i, 6]
        length = np.sqrt(dx * dx + dy * dy)
        if length < 0.1:  # too short to have a well-defined direction
            x0, y0 = x0 + 0.5 * dx - 0.05, y0 + 0.5 * dy
            length, dx, dy = 0.1, 0.1, 0.0
        outer, inner = radius + soft, max(radius - soft, 0.0)
        outer2, inner2 = outer * outer, inner * inner
        gain = 2.0 * radius * radius / ((outer2 + inner2) * (outer2 - inner2) * length)
        ux, uy = dx / length, dy / length
        top = np.int64(np.ceil(max(min(y0, y0 + dy) - outer, 0.0)))
        bottom = np.int64(np.floor(min(max(y0, y0 + dy) + outer, height - 1.0)))
        for y in range(top, bottom + 1):
            low, high = min(x0, x0 + dx) - outer, max(x0, x0 + dx) + outer
            if abs(uy) > 0.01:
                middle, reach = x0 + (y - y0) * ux / uy, outer / abs(uy)
                low, high = max(low, middle - reach), min(high, middle + reach)
            left, right = np.int64(np.ceil(max(low, 0.0))), np.int64(np.floor(min(high, width - 1.0)))
            row, scene = passed[y], depth[y]
            for x in range(left, right + 1):
                if z > scene[x]:
                    continue
                along = (x - x0) * ux + (y - y0) * uy
                across = (y - y0) * ux - (x - x0) * uy
                across = across * across
                share = _path_integral(outer2 - across, along, length) - _path_integral(inner2 - across, along, length)
                row[x] = row[x] * np.float32(1.0 - gain * max(share, 0.0))


@njit(cache=True, nogil=True, inline="always")
def _path_integral(square: Any, along: Any, length: Any) -> Any:
    """Return the integral of max(square - (along - s)^2, 0) over s in [0, length]."""
    if square <= 0.0:
        return 0.0
    half = np.sqrt(square)
    a, b = max(-half, along - length), min(half, along)
    if b <= a:
        return 0.0
    return square * (b - a) - (b * b * b - a * a * a) / 3.0


class Rain3d(Precipitation):
    """Adds raindrops that move consistently between the frames with gravity and wind, and are occluded by the scene."""

    name = "rain_3d"
    family = "depth"
    paper_severities = (10.0, 25.0, 50.0, 100.0, 200.0)
    colour = (228.0, 232.0, 236.0)
    # 200 sqrt(D / 2000) m/s for D in mm
    fall = Fall(slowest=0.0, spread=0.0, root=4.47213595499958, wind=4.0, flutter=0.1)

    def sizes(self, rate: float) -> Sizes:
        """Return the Marshall-Palmer drop size distribution."""
        # rounded, because the last bit of a power differs between machines
        return Sizes(8000.0, round(4.1 * rate**-0.21, 6), 6.0)


_SWELLING = 2.154
"""Ratio of a flake's diameter to its melted diameter; the density of snowflakes is a tenth of that of water."""


class Snow3d(Precipitation):
    """Adds snowflakes that move consistently between the frames with gravity and wind, and are occluded by the
    scene.
    """

    name = "snow_3d"
    family = "depth"
    paper_severities = (1.0, 2.0, 4.0, 7.0, 10.0)
    colour = (240.0, 242.0, 245.0)
    fall = Fall(slowest=1.0, spread=1.0, root=0.0, wind=3.0, flutter=0.5)

    def sizes(self, rate: float) -> Sizes:
        """Return the size distribution of Gunn and Marshall, scaled to the density of the flakes."""
        # rounded, because the last bit of a power differs between machines
        density = round(3800.0 * rate**-0.87 / _SWELLING, 6)
        return Sizes(density, round(2.55 * rate**-0.48 / _SWELLING, 6), 15.0)
