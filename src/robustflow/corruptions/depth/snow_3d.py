"""Snow as particles in the 3D scene."""

from __future__ import annotations

from .particles import Fall, Sizes
from .precipitation import Precipitation

_SWELLING = 2.154
"""Ratio of a flake's diameter to its melted diameter; the density of snowflakes is a tenth of that of water."""


class Snow3d(Precipitation):
    """Adds snowflakes that move consistently between the frames with gravity and wind, and are occluded by the scene.

    The severity parameter is the snowfall rate R in mm of water per hour; 2.5 mm/h or more is heavy snow. The melted
    diameters follow Gunn and Marshall (1958), N(D) = 3800 R^-0.87 exp(-2.55 R^-0.48 D) per cubic metre and millimetre.
    A flake is 2.154 times as wide as its melted diameter (a density of 0.1 g/cm^3) and at most 15 mm wide. Flakes of
    all sizes fall at 1 to 2 m/s (Locatelli and Hobbs, 1974, measured 0.8 to 2 m/s) and flutter by up to 0.5 m/s along
    each axis. The wind is drawn once per pair, at most 3 m/s. The exposure time is 2 ms, and the frames are 0.1 s
    apart.

    Flakes are white and opaque; near ones are out of focus (the aperture is 2 mm, and the focus is at 10 m). Flakes
    smaller than 0.06 % of the image's longer side (0.75 px at a width of 1242 px) form a veil of the same colour
    over distant parts of the scene.
    """

    name = "snow_3d"
    family = "depth"
    paper_severities = (1.0, 2.0, 4.0, 7.0, 10.0)
    colour = (240.0, 242.0, 245.0)
    fall = Fall(slowest=1.0, spread=1.0, root=0.0, wind=3.0, flutter=0.5)

    def sizes(self, rate: float) -> Sizes:
        """Return the size distribution of Gunn and Marshall, scaled to the density of the flakes.

        >>> Snow3d().sizes(2.0)
        Sizes(density=965.254425, slope=0.84879, largest=15.0)
        """
        # rounded, because the last bit of a power differs between machines
        density = round(3800.0 * rate**-0.87 / _SWELLING, 6)
        return Sizes(density, round(2.55 * rate**-0.48 / _SWELLING, 6), 15.0)
