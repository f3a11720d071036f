"""Draw one cell as a panel: the pair, the corrupted pair, both flows, ground truth and the error map, two in a row."""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..core.text import plain
from ..core.types import Frame
from ..media.colours import error_colours, flow_colours, flow_radius, thickened
from ..metrics.error_maps import epe_map
from ..report.gallery.layout import CAPTION, HEAD, LEFT, LEGEND, WIDEST, WIDTH, colour_wheel, error_scale, top_of
from ..run.worker import View

_TALLEST = 700
"""Maximum height of a picture in pixels."""
_JPEG_QUALITY = 88
_WHEEL = "direction and length of the flow, as colours"
_ERRORS = (("0.1 px or less", "lt"), ("1 px", "mt"), ("10 px", "mt"), ("100 px or more", "rt"))
"""Labels of the scale of errors, a third of it apart, with their anchors."""
_Captioned = tuple[str, Frame | None]


def draw_panel(panel: View, title: str, numbers: str, form: str = "png") -> bytes:
    """Return a panel as the content of a PNG or JPEG file; the same panel always yields the same bytes."""
    pictures = _pictures(panel)
    height, width = panel.sample.shape
    tile_height = max(1, round(min(WIDEST * height / width, _TALLEST)))
    image = Image.new("RGB", (WIDTH, HEAD + len(pictures) // 2 * (CAPTION + tile_height) + LEGEND), "white")
    draw = ImageDraw.Draw(image)
    draw.text((LEFT[0], HEAD / 2), title, "black", _font(20, bold=True), anchor="lm")
    draw.text((WIDTH - LEFT[0], HEAD / 2), numbers, "black", _font(20), anchor="rm")
    for place, (caption, picture) in enumerate(pictures):
        left, top = LEFT[place % 2], top_of(place, tile_height)
        if picture is not None:
            _paste(image, picture, (left, top), (max(1, round(tile_height * width / height)), tile_height))
            draw.text((left, top - CAPTION / 2), caption, "black", _font(20), anchor="lm")
        else:  # in place of ground truth
            middle = left + WIDEST // 2
            _paste(image, colour_wheel(tile_height), (middle - tile_height // 2, top))
            draw.text((middle, top - CAPTION / 2), _WHEEL, "black", _font(20), anchor="mm")
    below = image.height - LEGEND
    if all(picture is not None for _, picture in pictures):
        _paste(image, colour_wheel(80), (LEFT[0], below + 6))
        draw.text((LEFT[0] + 95, below + LEGEND / 2), _WHEEL, "black", _font(18), anchor="lm")
    _paste(image, error_scale(644), (LEFT[1] + 21, below + 28), (644, 14))
    for third, (text, anchor) in enumerate(_ERRORS):
        draw.text((LEFT[1] + 21 + third * 644 / 3, below + 50), text, "black", _font(18), anchor=anchor)
    out = io.BytesIO()
    options: dict[str, Any] = {"quality": _JPEG_QUALITY, "subsampling": 0} if form == "jpeg" else {}
    image.save(out, form, **options)
    return out.getvalue()


def _pictures(panel: View) -> list[_Captioned]:
    """Return the pictures with their captions; None where the colour wheel is. In a still scene, all flow is phantom
    motion."""
    (first, second), truth, valid = panel.sample.frames[:2], panel.sample.flow, panel.sample.valid
    if truth is not None and not truth.any() and np.array_equal(first, second):
        radius = flow_radius(panel.flow)
        phantom = f"phantom motion on the corrupted frames (full colour: {radius:.3g} px)"
        return [
            ("corrupted frame 1", panel.frames[0]),
            ("corrupted frame 2 (from the same frame)", panel.frames[1]),
            ("phantom motion on the clean frames", flow_colours(panel.clean_flow, radius)),
            (phantom, flow_colours(panel.flow, radius)),
            ("the frame, uncorrupted", first),
            ("length of the phantom motion on the corrupted frames", error_colours(epe_map(panel.flow, truth))),
        ]
    radius = flow_radius(panel.clean_flow) if truth is None else flow_radius(truth, valid)
    shown: list[_Captioned] = [
        ("frame 1", first),
        ("frame 2", second),
        ("corrupted frame 1", panel.frames[0]),
        ("corrupted frame 2", panel.frames[1]),
        (f"flow on the clean frames (full colour: {radius:.3g} px)", flow_colours(panel.clean_flow, radius)),
        ("flow on the corrupted frames", flow_colours(panel.flow, radius)),
    ]
    if truth is None or valid is None:
        return [
            *shown,
            ("", None),
            ("difference of the two flows", error_colours(epe_map(panel.flow, panel.clean_flow))),
        ]
    errors = np.where(valid, epe_map(panel.flow, truth), np.nan)
    error = thickened(error_colours(errors), ~np.isnan(errors))
    known = thickened(flow_colours(truth, radius, valid), valid)
    return [
        *shown,
        ("ground truth (black: unknown)", known),
        ("end-point error on the corrupted frames (grey: unknown)", error),
    ]


def _paste(image: Image.Image, picture: Frame, place: tuple[int, int], size: tuple[int, int] | None = None) -> None:
    """Paste a picture at (left, top), resized to (width, height) if they are given: averaged if it becomes smaller."""
    made = Image.fromarray(np.ascontiguousarray(picture))
    if size is not None:
        made = made.resize(size, Image.Resampling.BOX if size[0] <= made.width else Image.Resampling.NEAREST)
    image.paste(made, place)


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    import matplotlib  # imported late, because a run whose pictures exist draws none

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", name), size)


def numbers_line(epe: float | None, cre: float | None, rcre: float | None) -> str:
    """Return the scores of a cell in one line, omitting those that are None.

    >>> numbers_line(None, None, 0.5), numbers_line(2.0, 0.25, 1.0)
    ('RCRE 0.50 px', 'EPE 2.00 px   CRE +0.25 px   RCRE 1.00 px')
    """
    scores = (("EPE", epe, ""), ("CRE", cre, "+"), ("RCRE", rcre, ""))
    return "   ".join(f"{name} {value:{sign}.2f} px" for name, value, sign in scores if value is not None)


def panel_title(key: str, corruption: str, severity: int, why: str = "") -> str:
    """Return the title of a panel; names come from files, so they are sanitised."""
    what = f"{plain(key, 40)}, {plain(corruption, 40)} severity {severity}"
    return f"{why}: {what}" if why else what
