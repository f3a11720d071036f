"""Attacks on a pair at a glance: a row for each, with the frame, what was added to it, and the flow."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...attacks.result import Attacked
from ...figure_style import add_picture, default_style
from ...images.flow_colours import flow_colours, flow_radius
from ...images.io import shrunk
from ...sample import Frame

_COLUMN_IN = 2.8
_CAPTION_IN = 0.22
_MARGIN_IN = 0.04
_DPI = 130
_QUALITY = 85
_GREY = 128
_REACH = 100
"""Grey levels from the middle that the largest change has in a picture."""


@default_style()
def draw_attacks(clean: Frame, attacked: Sequence[Attacked], model: str) -> bytes:
    """A row for each attack: attacked frame 1, its change magnified around grey, flow before and after; a WebP file.

    Args:
        clean: frame 1, RGB uint8 (H, W, 3).
        attacked: what attacks gave for the pair.
        model: its name, for the captions.

    Returns:
        The file's bytes, the same for the same arguments.
    """
    height, width = clean.shape[:2]
    picture = _COLUMN_IN * height / width
    step = picture + _CAPTION_IN
    size = (4 * (_COLUMN_IN + _MARGIN_IN) + _MARGIN_IN, len(attacked) * step + _MARGIN_IN)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
    for row, one in enumerate(attacked):
        change, factor = magnified(clean, one.frames[0])
        radius = flow_radius(one.clean_flow)
        doubt = " (with a warning)" if one.warnings else ""
        columns = (
            (f"{one.attack}, {one.budget:g} grey levels {one.norm}{doubt}", one.frames[0]),
            (f"change of frame 1, times {factor:g}", change),
            (f"{model}, clean frames", flow_colours(one.clean_flow, radius)),
            (f"{model}, attacked: moved by {one.moved:.2f} px", flow_colours(one.flow, radius)),
        )
        for place, (title, shown) in enumerate(columns):
            left, top = _MARGIN_IN + place * (_COLUMN_IN + _MARGIN_IN), row * step + _CAPTION_IN
            add_picture(figure, left, top, _COLUMN_IN, picture, shrunk(shown, round(_COLUMN_IN * _DPI)), title, 8)
    file = io.BytesIO()
    figure.savefig(file, format="webp", pil_kwargs={"quality": _QUALITY, "method": 6})
    return file.getvalue()


def magnified(clean: Frame, attacked: Frame) -> tuple[Frame, float]:
    """What was added to a frame, around grey, and how many times it is magnified; grey and 1 for an unchanged frame.

    >>> picture, factor = magnified(np.zeros((1, 2, 3), np.uint8), np.array([[[4, 0, 2], [0, 0, 0]]], np.uint8))
    >>> picture.tolist(), factor
    ([[[228, 128, 178], [128, 128, 128]]], 25.0)
    """
    change = attacked.astype(np.int16) - clean
    largest = int(np.abs(change).max())
    factor = max(_REACH / largest, 1.0) if largest else 1.0
    return np.clip(np.rint(_GREY + factor * change), 0, 255).astype(np.uint8), factor
