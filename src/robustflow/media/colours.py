"""Render flow, depth and errors as images, and make sparse maps visible.

Flow: hue encodes direction, saturation encodes magnitude (Baker et al., "A Database and Evaluation Methodology for
Optical Flow", IJCV 2011, Sec. 4.4, with the colour wheel from their software). Zero flow is white; flow to the right is
red, down is yellow, left is cyan-blue, and up is violet. Vectors whose magnitude equals the radius are fully saturated;
longer vectors are darkened to three quarters of the brightness, and unknown flow is black.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError
from ..core.types import DepthMap, Flow, Frame, Mask
from ..metrics.error_maps import Errors

REACH = 2.0
"""Radius in pixels by which known points are dilated, for display only."""

SPARSE = 0.5
"""Maps with a smaller fraction of known pixels are treated as sparse; in dense maps, unknown pixels stay visible."""


def thickened(picture: Frame, known: Mask) -> Frame:
    """Fill unknown pixels of a sparse map with the colour of the nearest known pixel within `REACH`; leave dense maps
    unchanged.
    """
    if not 0 < known.mean() < SPARSE:
        return picture
    from scipy.ndimage import distance_transform_edt  # dense maps do not need this import of 0.15 s

    distance, nearest = distance_transform_edt(~known, return_indices=True)
    grown = picture[tuple(nearest)]
    return np.where((distance <= REACH)[..., None], grown, picture)


# Segments of the wheel: number of steps, first colour, and the channel that increases (+) or decreases (-).
_STRETCHES = (
    (15, (255, 0, 0), 1, +1),  # red to yellow
    (6, (255, 255, 0), 0, -1),  # yellow to green
    (4, (0, 255, 0), 2, +1),  # green to cyan
    (11, (0, 255, 255), 1, -1),  # cyan to blue
    (13, (0, 0, 255), 0, +1),  # blue to magenta
    (6, (255, 0, 255), 2, -1),  # magenta to red
)
_BEYOND = 0.75


def colour_wheel() -> npt.NDArray[np.float64]:
    """Return the 55 colours of the wheel, float64 (55, 3), range 0 to 255, starting with red (flow to the right)."""
    colours = []
    for steps, first, channel, sign in _STRETCHES:
        stretch = np.tile(np.array(first, np.float64), (steps, 1))
        stretch[:, channel] += sign * np.floor(255 * np.arange(steps) / steps)
        colours.append(stretch)
    return np.concatenate(colours)


def flow_radius(flow: Flow, valid: Mask | None = None) -> float:
    """Return a suitable radius for a flow field: the 99th percentile of its known magnitudes in pixels, but at least
    1.
    """
    length = np.linalg.norm(flow.astype(np.float64), axis=2)
    known = length[np.isfinite(length) if valid is None else valid & np.isfinite(length)]
    return max(1.0, float(np.quantile(known, 0.99))) if known.size else 1.0


def flow_colours(flow: Flow, radius: float, valid: Mask | None = None) -> Frame:
    """Render a flow field as an image."""
    if flow.ndim != 3 or flow.shape[2] != 2 or not radius > 0:
        raise DataError("flow", f"cannot colour {flow.shape} with radius {radius}; pass (H, W, 2), a positive radius")
    known = np.asarray(np.isfinite(flow).all(axis=2))
    if valid is not None:
        known = known & valid
    u, v = np.moveaxis(np.where(known[..., None], flow, 0).astype(np.float64) + 0.0, 2, 0)  # + 0.0 turns -0.0 into 0.0
    wheel = colour_wheel() / 255
    place = (np.arctan2(-v, -u) / np.pi + 1) / 2 * (len(wheel) - 1)
    before = place.astype(np.intp)
    share = (place - before)[..., None]
    colour = (1 - share) * wheel[before] + share * wheel[(before + 1) % len(wheel)]
    length = (np.hypot(u, v) / radius)[..., None]
    colour = np.where(length <= 1, 1 - length * (1 - colour), _BEYOND * colour)
    return np.where(known[..., None], np.floor(255 * colour), 0).astype(np.uint8)


def depth_colours(depth: DepthMap) -> Frame:
    """Render a depth map in grey, with brightness proportional to inverse depth; the nearest pixel is white.

    >>> depth_colours(np.array([[2.0, 4.0, 200.0]], np.float32))[0, :, 0].tolist()
    [255, 128, 3]
    """
    grey = np.rint(255 * (depth.min() / depth)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


LOWEST, HIGHEST = 0.1, 100.0
"""Limits of the colour scale of errors, in pixels, the same in every image; errors outside this range are clipped."""

COLOUR_MAP = "inferno"
UNKNOWN_COLOUR = (160, 160, 160)
"""Colour of pixels whose error is undefined: no ground truth, or a non-finite prediction."""


def error_colours(errors: Errors) -> Frame:
    """Render an error map in pixels as RGB uint8 (H, W, 3), on a logarithmic scale from black (`LOWEST` or less) to
    pale yellow (`HIGHEST` or more); NaN is grey.
    """
    from matplotlib import colormaps  # 0.2 s that flow and depth do not need
    from matplotlib.colors import LogNorm

    shown = np.clip(np.nan_to_num(errors, nan=LOWEST), LOWEST, HIGHEST)
    colours: Frame = colormaps[COLOUR_MAP](LogNorm(LOWEST, HIGHEST)(shown), bytes=True)[..., :3]
    colours[np.isnan(errors)] = UNKNOWN_COLOUR
    return colours
