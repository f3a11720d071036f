"""The gallery as a figure like the paper's: all corruptions at one severity, as PNG or PDF."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from ...figure_style import add_picture, default_style
from ...sample import Frame
from ...text import plain
from .pictures import GalleryCell

_WIDTH_IN = 12.0
_CAPTION_IN = 0.26
_GAP_IN = 0.06
_DPI = 160


@default_style()
def draw_figure(clean: Frame, cells: Sequence[GalleryCell], title: str, form: str) -> bytes:
    """Draw the clean frame and one picture per cell, with three (for wide frames) to five pictures per row."""
    ratio = clean.shape[0] / clean.shape[1]
    columns = min(len(cells) + 1, 3 if ratio < 0.4 else 4 if ratio < 0.6 else 5)
    rows = math.ceil((len(cells) + 1) / columns)
    width = (_WIDTH_IN - _GAP_IN) / columns - _GAP_IN
    step = width * ratio + _CAPTION_IN
    height = rows * step + _CAPTION_IN + _GAP_IN
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=_DPI, facecolor="white")
    figure.text(0.006, 1 - _CAPTION_IN / height, plain(title, 160), va="center", fontsize=11, parse_math=False)
    absent = clean * 0 + 236
    shown = [("clean", clean)]
    shown += [
        (f"{cell.name}  {cell.caption}".rstrip(), cell.frames[cell.still] if cell.frames else absent) for cell in cells
    ]
    for index, (caption, frame) in enumerate(shown):
        row, column = divmod(index, columns)
        left, top = _GAP_IN + column * (width + _GAP_IN), _CAPTION_IN + row * step + _CAPTION_IN
        add_picture(figure, left, top, width, width * ratio, frame, caption, 8.5)
        if frame is absent:
            middle = (left + width / 2) / _WIDTH_IN, 1 - (top + width * ratio / 2) / height
            figure.text(*middle, "not on this scale", ha="center", va="center", fontsize=9)
    file = io.BytesIO()
    figure.savefig(file, format=form, metadata={"CreationDate": None} if form == "pdf" else None)
    return file.getvalue()
