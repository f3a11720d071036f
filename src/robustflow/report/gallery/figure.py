"""The gallery as a figure like the paper's: all corruptions at one severity, as PNG or PDF."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from ...figure_style import add_picture, default_style
from ...sample import Frame
from .pictures import CorruptedPicture

_WIDTH_IN = 12.0
_CAPTION_IN = 0.26
_GAP_IN = 0.06
_DPI = 160


@default_style()
def draw_figure(clean: Frame, cells: Sequence[CorruptedPicture], title: str, form: str) -> bytes:
    """Draw the clean frame and one picture per cell, with three (for wide frames) to five pictures per row.

    Args:
        clean: clean frame, RGB uint8 (H, W, 3).
        cells: cells of one severity.
        title: title line above the pictures.
        form: file format, "png" or "pdf".

    Returns:
        The bytes of the file; equal arguments give equal bytes.
    """
    ratio = clean.shape[0] / clean.shape[1]
    columns = min(len(cells) + 1, 3 if ratio < 0.4 else 4 if ratio < 0.6 else 5)
    rows = math.ceil((len(cells) + 1) / columns)
    width = (_WIDTH_IN - _GAP_IN) / columns - _GAP_IN
    step = width * ratio + _CAPTION_IN
    height = rows * step + _CAPTION_IN + _GAP_IN
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=_DPI, facecolor="white")
    figure.text(0.006, 1 - _CAPTION_IN / height, title, va="center", fontsize=11)
    shown = [("clean", clean), *((caption(cell), cell.frame) for cell in cells)]
    for index, (words, frame) in enumerate(shown):
        row, column = divmod(index, columns)
        left, top = _GAP_IN + column * (width + _GAP_IN), _CAPTION_IN + row * step + _CAPTION_IN
        picture = clean * 0 + 236 if frame is None else frame
        add_picture(figure, left, top, width, width * ratio, picture, words, 8.5)
        if frame is None:
            middle = (left + width / 2) / _WIDTH_IN, 1 - (top + width * ratio / 2) / height
            figure.text(*middle, "not on this scale", ha="center", va="center", fontsize=9)
    file = io.BytesIO()
    figure.savefig(file, format=form, metadata={"CreationDate": None} if form == "pdf" else None)
    return file.getvalue()


def caption(cell: CorruptedPicture) -> str:
    """Return the caption above a picture.

    >>> import numpy as np
    >>> caption(CorruptedPicture("over_exposure", 2, np.zeros((1, 1, 3), np.uint8), index=1, ssim=0.8231))
    'over_exposure (frame 2)  SSIM 0.82'
    """
    if cell.frame is None:
        return cell.name
    if cell.caption:
        return f"{cell.name}, {cell.caption}"
    which = " (frame 2)" if cell.index else ""
    return f"{cell.name}{which}  SSIM {cell.ssim:.2f}"
