"""Rain as particles in the 3D scene."""

from __future__ import annotations

from .particles import Fall, Sizes
from .precipitation import Precipitation


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
