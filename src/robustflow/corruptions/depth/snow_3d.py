"""Snow in three dimensions."""

from __future__ import annotations

from .particles import Fall, Sizes
from .precipitation import Precipitation

_SWELLING = 2.154
"""Diameter of a flake over that of the water in it: aggregates have a tenth of water's density."""


class Snow3d(Precipitation):
    """Snow flakes in the world, the same in both frames, moved by gravity and wind and hidden behind the scene.

    A severity is the snowfall rate R in mm of water an hour; 2.5 mm/h and more is heavy snow. The water in the flakes
    has the diameters of Gunn and Marshall (1958), N(D) = 3800 R^-0.87 exp(-2.55 R^-0.48 D) a cubic metre and
    millimetre; a flake is 2.154 times as wide, at a density of 0.1 g/cm^3, and at most 15 mm. Flakes fall at 1 to 2 m/s
    whatever their size (Locatelli and Hobbs, 1974, measured 0.8 to 2) and flutter by up to 0.5 m/s along each axis. The
    wind is drawn for the pair, at most 3 m/s. The shutter is open for 2 ms, the frames are 0.1 s apart.

    Flakes are white and opaque; near ones are out of focus (an aperture of 2 mm, focused at 10 m). Flakes smaller than
    0.06 % of the image's width (0.75 px of 1242) are a veil of the same colour over what is far.
    """

    name = "snow_3d"
    family = "depth"
    paper_severities = (1.0, 2.0, 4.0, 7.0, 10.0)
    colour = (240.0, 242.0, 245.0)
    fall = Fall(slowest=1.0, spread=1.0, root=0.0, wind=3.0, flutter=0.5)

    def sizes(self, rate: float) -> Sizes:
        """Flakes of Gunn and Marshall, swollen.

        >>> Snow3d().sizes(2.0)
        Sizes(density=965.254425, slope=0.84879, largest=15.0)
        """
        # rounded, as the last bit of a power differs between machines
        density = round(3800.0 * rate**-0.87 / _SWELLING, 6)
        return Sizes(density, round(2.55 * rate**-0.48 / _SWELLING, 6), 15.0)
