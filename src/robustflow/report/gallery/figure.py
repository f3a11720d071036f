"""The gallery as a figure: the paper's figure of all corruptions at one severity, as PNG or PDF."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...figure_style import default_style
from ...sample import Frame
from .pictures import CorruptedPicture

_WIDTH_IN = 12.0
_CAPTION_IN = 0.26
_DPI = 160


@default_style()
def draw_figure(clean: Frame, cells: Sequence[CorruptedPicture], title: str, form: str) -> bytes:
    """The clean frame and one picture per cell, in rows of three (wide frames) to five.

    Args:
        clean: RGB uint8 (H, W, 3).
        cells: of one severity.
        title: one line above the pictures.
        form: "png" or "pdf".

    Returns:
        The file's bytes, the same for the same arguments.
    """
    ratio = clean.shape[0] / clean.shape[1]
    columns = min(len(cells) + 1, 3 if ratio < 0.4 else 4 if ratio < 0.6 else 5)
    rows = math.ceil((len(cells) + 1) / columns)
    picture = _WIDTH_IN / columns * ratio
    height = rows * (picture + _CAPTION_IN) + 2 * _CAPTION_IN
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=_DPI, facecolor="white")
    figure.text(0.006, 1 - _CAPTION_IN / height, title, va="center", fontsize=11)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    figure.subplots_adjust(0.005, 0.005, 0.995, 1 - 2 * _CAPTION_IN / height, 0.02, _CAPTION_IN / picture)
    for ax in axes:
        ax.axis("off")
    _show(axes[0], clean, "clean")
    for ax, cell in zip(axes[1:], cells, strict=False):
        if cell.frame is None:
            _show(ax, clean * 0 + 236, cell.name)
            ax.text(0.5, 0.5, "not on this scale", transform=ax.transAxes, ha="center", va="center", fontsize=9)
        else:
            _show(ax, cell.frame, caption(cell))
    file = io.BytesIO()
    figure.savefig(file, format=form, metadata={"CreationDate": None} if form == "pdf" else None)
    return file.getvalue()


def caption(cell: CorruptedPicture) -> str:
    """The line above a picture.

    >>> caption(CorruptedPicture("over_exposure", 2, index=1, ssim=0.8231))
    'over_exposure (frame 2)  SSIM 0.82'
    """
    which = " (frame 2)" if cell.index else ""
    return f"{cell.name}{which}  SSIM {cell.ssim:.2f}"


def _show(ax: Axes, frame: Frame, title: str) -> None:
    ax.imshow(frame, aspect="auto")
    ax.set_title(title, fontsize=8.5, pad=2.5, loc="left")
