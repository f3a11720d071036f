"""The outline of a layer: an ellipse or a convex polygon, with a wobble. For use inside compiled loops.

An outline is stored as one row of `OUTLINE` float64 values:

    cx cy  a b c d (matrix to outline coordinates)  radius  sides  wobble  kx sx ky sy  then nx ny of each side

`sides` is 0 for an ellipse and negative for a background, which covers everything.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiled import njit
from .motion import wave

SIDES = 6
"""Maximum number of sides of a polygon."""
OUTLINE = 13 + 2 * SIDES
"""Length of an outline's parameter row."""


@njit(cache=True, nogil=True)
def inset(o: Any, x: Any, y: Any) -> Any:
    """Return the approximate distance, in pixels, of a point of frame 1 from the outline: positive inside, negative
    outside, infinite for a background."""
    if o[7] < 0.0:
        return np.inf
    x, y = x - o[0], y - o[1]
    u, v = o[2] * x + o[3] * y, o[4] * x + o[5] * y
    u, v = u + o[8] * wave(o[9] * v + o[10]), v + o[8] * wave(o[11] * u + o[12])
    sides = int(o[7])
    if sides == 0:
        reach = np.sqrt(u * u + v * v)
    else:
        reach = -np.inf
        for side in range(sides):
            reach = max(reach, o[13 + 2 * side] * u + o[14 + 2 * side] * v)
    return (1.0 - reach) * o[6]
