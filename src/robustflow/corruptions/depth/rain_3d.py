"""Rain as particles in the 3D scene."""

from __future__ import annotations

from .particles import Fall, Sizes
from .precipitation import Precipitation


class Rain3d(Precipitation):
    """Adds raindrops that move consistently between the frames with gravity and wind, and are occluded by the scene.

    The severity parameter is the rain rate R in mm/h. Drop diameters follow Marshall and Palmer (1948), N(D) = 8000
    exp(-4.1 R^-0.21 D) per cubic metre and millimetre, up to 6 mm. Drops of radius a (in metres) fall at 200 sqrt(a)
    m/s (Garg and Nayar, Vision and Rain, 2007): 4.5 m/s for a diameter of 1 mm, 8.9 m/s for 4 mm. The wind is drawn
    once per pair, at most 4 m/s. The exposure time is 2 ms, and the frames are 0.1 s apart.

    A drop refracts light from most of the hemisphere in front of it, so it is about as bright as the sky regardless of
    the background (Garg and Nayar); here, all drops are light grey. A drop's weight at a pixel is the fraction of the
    exposure during which it covers the pixel. Drops smaller than 0.06 % of the image's longer side (0.75 px at a
    width of 1242 px) form a veil of the same colour over distant parts of the scene, as in Halder et al., Physics-Based
    Rendering for Improving Robustness to Rain, 2019.
    """

    name = "rain_3d"
    family = "depth"
    paper_severities = (10.0, 25.0, 50.0, 100.0, 200.0)
    colour = (228.0, 232.0, 236.0)
    # 200 sqrt(D / 2000) m/s for D in mm
    fall = Fall(slowest=0.0, spread=0.0, root=4.47213595499958, wind=4.0, flutter=0.1)

    def sizes(self, rate: float) -> Sizes:
        """Return the Marshall-Palmer drop size distribution.

        >>> Rain3d().sizes(100.0)
        Sizes(density=8000.0, slope=1.558777, largest=6.0)
        """
        # rounded, because the last bit of a power differs between machines
        return Sizes(8000.0, round(4.1 * rate**-0.21, 6), 6.0)
