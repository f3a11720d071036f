"""Render errors in pixels as colours, on the same logarithmic scale in every image."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm

from ..core.types import Frame
from ..metrics.error_maps import Errors

LOWEST, HIGHEST = 0.1, 100.0
"""Limits of the colour scale in pixels; errors outside this range are clipped."""

COLOUR_MAP = "inferno"
UNKNOWN_COLOUR = (160, 160, 160)
"""Colour of pixels whose error is undefined: no ground truth, or a non-finite prediction."""


def error_colours(errors: Errors) -> Frame:
    """Render an error map as RGB uint8 (H, W, 3), from black (`LOWEST` or less) to pale yellow (`HIGHEST` or more); NaN
    is grey.
    """
    shown = np.clip(np.nan_to_num(errors, nan=LOWEST), LOWEST, HIGHEST)
    colours: Frame = colormaps[COLOUR_MAP](LogNorm(LOWEST, HIGHEST)(shown), bytes=True)[..., :3]
    colours[np.isnan(errors)] = UNKNOWN_COLOUR
    return colours
