"""The gallery as a figure like the paper's (PNG or PDF), and as a self-contained HTML file with a slider."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence

from matplotlib.figure import Figure

from ...core.display import add_picture, default_style
from ...core.text import plain
from ...core.types import Frame
from ..notebook import content_policy, templates
from ..slider import Slider, make_slider, script, slider_markup, style
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


WIDEST = 480
"""Maximum picture width in pixels; the hundred pictures of a page take a few megabytes."""

WIDEST_OF_CLIP = 288
"""Maximum picture width in pixels for a clip, whose page contains about a thousand pictures."""


def gallery_slider(
    title: str,
    clean: Sequence[Frame],
    cells: Iterable[GalleryCell],
    severities: Sequence[int],
    severity: int,
    first_frame: int = 0,
) -> Slider:
    """Make the slider of a gallery."""
    widest, quality = (WIDEST, 80) if len(clean) == 1 else (WIDEST_OF_CLIP, 50)
    return make_slider(
        title,
        clean,
        _pictures(cells),
        widest=widest,
        quality=quality,
        severities=tuple(severities),
        start=severity,
        together=True,
        absent="not on this scale",
        first_frame=first_frame,
    )


def example_slider(clean: Frame, cells: Iterable[GalleryCell], title: str) -> Slider:
    """Make a slider to be embedded in a larger page. It shows one corruption at a time; its hundred pictures take about
    a megabyte."""
    return make_slider(title, [clean], _pictures(cells), widest=256, quality=50)


def _pictures(cells: Iterable[GalleryCell]) -> Iterator[tuple[str, int, Sequence[Frame], str]]:
    return ((cell.name, cell.severity, cell.frames, cell.caption) for cell in cells)


def page_of(slider: Slider, remarks: Sequence[str] = ()) -> str:
    """Return a page with a slider, and with remarks below its title."""
    return (
        templates("robustflow.report.gallery")
        .get_template("gallery.html")
        .render(
            title=slider.title,
            remarks=remarks,
            slider=slider_markup(slider),
            style=style(),
            script=script(),
            policy=content_policy(script()),
        )
    )
