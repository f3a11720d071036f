"""The layout of a panel, which a page cuts into its pictures, and the keys of its colours."""

from __future__ import annotations

import numpy as np

from ...core.types import Flow, Frame
from ...media.colours import HIGHEST, LOWEST, error_colours, flow_colours

WIDTH = 1400
"""Width of a panel in pixels."""
LEFT, WIDEST = (7, 707), 690
HEAD, CAPTION, LEGEND = 40, 34, 92
"""Height of the heading, of a caption and of the legend at the bottom, in pixels."""


def picture_of_panel(panel: Frame, place: int, rows: int) -> Frame | None:
    """Cut one picture, counted in the order of drawing, out of the image of a panel with so many rows of pictures. None
    if the image does not have the size of such a panel."""
    each = (len(panel) - HEAD - LEGEND) // rows - CAPTION
    if panel.shape[1] != WIDTH or each < 1:
        return None
    top, left = top_of(place, each), LEFT[place % 2]
    return panel[top : top + each, left : left + WIDEST]


def top_of(place: int, each: int) -> int:
    """Return the upper end of a picture, counted in the order of drawing, of height `each`, in pixels."""
    return HEAD + place // 2 * (CAPTION + each) + CAPTION


def colour_wheel(size: int) -> Frame:
    """Return the key of the colours of flows, RGB uint8 (size, size, 3), white outside its circle."""
    side = np.linspace(-1, 1, size, dtype=np.float32)
    flow: Flow = np.stack(np.meshgrid(side, side), axis=2)
    colours = flow_colours(flow, 1.0)
    colours[np.hypot(*np.moveaxis(flow, 2, 0)) > 1] = 255
    return colours


def error_scale(width: int) -> Frame:
    """Return the colours of errors from 0.1 to 100 px, RGB uint8 (1, width, 3)."""
    return error_colours(np.geomspace(LOWEST, HIGHEST, width)[None])
