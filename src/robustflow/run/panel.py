"""Draw one cell as a panel: the pair, the corrupted pair, both flows, ground truth and the error map."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from PIL import Image

from ..core.display import add_picture, default_style
from ..core.text import name_text
from ..core.types import Frame
from ..media.colours import COLOUR_MAP, HIGHEST, LOWEST, error_colours, flow_colours, flow_radius, thickened
from ..metrics.error_maps import epe_map

if TYPE_CHECKING:
    from .worker import View

_WIDTH_IN = 14.0
_TALLEST_IN = 7.0
_TITLE_IN = 0.34
_HEAD_IN = 0.4
_BAR_IN = 0.92
_WHEEL_IN = 0.8
_TITLE_PT = 15  # readable when a page shows two panels side by side
_DPI = 100
_JPEG_QUALITY = 88
_WHEEL_SAYS = "direction and length of the flow, as colours"


@default_style()
def draw_panel(panel: View, title: str, numbers: str, form: Literal["png", "jpeg"] = "png") -> bytes:
    """Return a panel as the content of an image file; the same panel always yields the same bytes."""
    sample = panel.sample
    truth, valid = sample.flow, sample.valid
    if truth is not None and not truth.any() and np.array_equal(sample.frames[0], sample.frames[1]):
        return _file(_figure(sample.shape, title, numbers, _still_pictures(panel)), form)
    radius = flow_radius(panel.clean_flow) if truth is None else flow_radius(truth, valid)
    pictures: list[tuple[str, Frame | None]] = [
        ("frame 1", sample.frames[0]),
        ("frame 2", sample.frames[1]),
        ("corrupted frame 1", panel.frames[0]),
        ("corrupted frame 2", panel.frames[1]),
        (f"flow on the clean frames (full colour: {radius:.3g} px)", flow_colours(panel.clean_flow, radius)),
        ("flow on the corrupted frames", flow_colours(panel.flow, radius)),
    ]
    if truth is None or valid is None:
        change = error_colours(epe_map(panel.flow, panel.clean_flow))
        pictures += [("", None), ("difference of the two flows", change)]
    else:
        errors = np.where(valid, epe_map(panel.flow, truth), np.nan)
        error = thickened(error_colours(errors), ~np.isnan(errors))
        known = thickened(flow_colours(truth, radius, valid), valid)
        pictures += [("ground truth (black: unknown)", known)]
        pictures += [("end-point error on the corrupted frames (grey: unknown)", error)]
    figure = _figure(sample.shape, title, numbers, pictures)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # characters that the font lacks are shown as boxes
        return _file(figure, form)


def picture_of_panel(panel: Frame, place: int, rows: int) -> Frame | None:
    """Cut one picture, counted in the order of drawing, out of the image of a panel with so many rows of pictures. None
    if the image does not have the size of such a panel."""
    height, width = panel.shape[:2]
    inch = width / _WIDTH_IN
    each = ((height / inch) - _HEAD_IN - _BAR_IN) / rows - _TITLE_IN
    row, column = divmod(place, 2)
    top, left = _HEAD_IN + row * (each + _TITLE_IN) + _TITLE_IN, (0.005 + 0.5 * column) * _WIDTH_IN
    ends = (top, top + each, left, left + _WIDTH_IN / 2 * 0.985)
    first, last, start, stop = (round(inch * end) for end in ends)
    return panel[first:last, start:stop] if first < last and start < stop else None


def _still_pictures(panel: View) -> list[tuple[str, Frame | None]]:
    """Return the images for a static scene, in which all flow is phantom motion."""
    radius = flow_radius(panel.flow)
    zero = np.zeros_like(panel.flow)
    return [
        ("corrupted frame 1", panel.frames[0]),
        ("corrupted frame 2 (from the same frame)", panel.frames[1]),
        ("phantom motion on the clean frames", flow_colours(panel.clean_flow, radius)),
        (f"phantom motion on the corrupted frames (full colour: {radius:.3g} px)", flow_colours(panel.flow, radius)),
        ("the frame, uncorrupted", panel.sample.frames[0]),
        ("length of the phantom motion on the corrupted frames", error_colours(epe_map(panel.flow, zero))),
    ]


def _figure(shape: tuple[int, int], heading: str, numbers: str, pictures: list[tuple[str, Frame | None]]) -> Figure:
    height, width = shape
    each = min(_WIDTH_IN / 2 * 0.985 * height / width, _TALLEST_IN)
    rows = len(pictures) // 2
    total = _HEAD_IN + rows * (each + _TITLE_IN) + _BAR_IN
    figure = Figure(figsize=(_WIDTH_IN, total), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    head = 1 - _HEAD_IN / total / 2
    figure.text(0.005, head, heading, va="center", fontsize=14, fontweight="bold")
    figure.text(0.995, head, numbers, va="center", ha="right", fontsize=14)
    for index, (title, picture) in enumerate(pictures):
        row, column = divmod(index, 2)
        top = _HEAD_IN + row * (each + _TITLE_IN) + _TITLE_IN
        left = (0.005 + 0.5 * column) * _WIDTH_IN
        if picture is None:  # shown in place of ground truth
            axes = figure.add_axes((left / _WIDTH_IN, 1 - (top + each) / total, 0.4925, each / total))
            _wheel(axes)
            axes.set_title(_WHEEL_SAYS, fontsize=_TITLE_PT, pad=4)
        else:
            add_picture(figure, left, top, each * width / height, each, picture, title, _TITLE_PT)
    if all(picture is not None for _, picture in pictures):
        _wheel(figure.add_axes((0.005, 0.06 / total, _WHEEL_IN / _WIDTH_IN, _WHEEL_IN / total)))
        x = 0.005 + (_WHEEL_IN + 0.15) / _WIDTH_IN
        figure.text(x, (0.06 + _WHEEL_IN / 2) / total, _WHEEL_SAYS, va="center", fontsize=13)
    _error_scale(figure, figure.add_axes((0.52, 0.5 / total, 0.46, 0.14 / total)))
    return figure


def _error_scale(figure: Figure, axes: Axes) -> None:
    shade = ScalarMappable(LogNorm(LOWEST, HIGHEST), colormaps[COLOUR_MAP])
    bar = figure.colorbar(shade, cax=axes, orientation="horizontal", extend="both")
    bar.minorticks_off()  # drawing the ticks would take a quarter of the time needed for a panel
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} px"))
    bar.ax.tick_params(labelsize=13)


def _wheel(axes: Axes) -> None:
    side = np.linspace(-1, 1, 161, dtype=np.float32)
    flow = np.stack(np.meshgrid(side, side), axis=2)
    colours = flow_colours(flow, 1.0)
    colours[np.hypot(*np.moveaxis(flow, 2, 0)) > 1] = 255
    axes.axis("off")
    axes.imshow(colours, aspect="equal")


def numbers_line(epe: float | None, cre: float | None, rcre: float | None) -> str:
    """Return the scores of a cell in one line, omitting those that are None.

    >>> numbers_line(None, None, 0.5), numbers_line(2.0, 0.25, 1.0)
    ('RCRE 0.50 px', 'EPE 2.00 px   CRE +0.25 px   RCRE 1.00 px')
    """
    scores = (("EPE", epe, ""), ("CRE", cre, "+"), ("RCRE", rcre, ""))
    return "   ".join(f"{name} {value:{sign}.2f} px" for name, value, sign in scores if value is not None)


def panel_title(key: str, corruption: str, severity: int, why: str = "") -> str:
    """Return the title of a panel; names come from files, so they are sanitised."""
    what = f"{name_text(key)}, {name_text(corruption)} severity {severity}"
    return f"{why}: {what}" if why else what


def _file(figure: Figure, form: Literal["png", "jpeg"]) -> bytes:
    out = io.BytesIO()
    if form == "png":
        figure.savefig(out, format="png", metadata={"Software": None})
    else:
        raw = io.BytesIO()
        figure.savefig(raw, format="rgba")
        width, height = (round(side * _DPI) for side in figure.get_size_inches())
        pixels = np.frombuffer(raw.getvalue(), np.uint8).reshape(-1, width, 4)[:, :, :3]
        assert len(pixels) - height in (-1, 0, 1)
        Image.fromarray(np.ascontiguousarray(pixels)).save(out, "JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return out.getvalue()
