"""Snow as particles in the 3D scene."""

from __future__ import annotations

from .particles import Fall, Sizes
from .precipitation import Precipitation

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
