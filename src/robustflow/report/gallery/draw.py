"""Pictures in a grid: the corruptions of a frame, and for a model frames, flow and errors under each corruption or
attack."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...attacks.result import Attacked
from ...core.display import add_picture, default_style
from ...core.text import plain
from ...core.types import Flow, Frame, Sample
from ...corruptions import Corruption, corrupt_clip
from ...media.colours import error_colours, flow_colours, flow_radius, thickened
from ...media.images import shrunk
from ...metrics.error_maps import epe_map
from .cells import GalleryCell

_CAPTION_IN = 0.26
_GAP_IN = 0.06
_WIDTH_IN = 12.0
_GREY = 128
_REACH = 100
"""Distance in grey levels between mid-grey and the largest change in a picture."""

_Titled = tuple[str, Frame | None]
"""A picture, RGB uint8 (H, W, 3), with its title; None where there is no picture."""


@default_style()
def draw_grid(
    rows: Sequence[Sequence[_Titled]], width: float, form: str, title: str = "", dpi: int = 160, **options: Any
) -> bytes:
    """Draw rows of pictures of equal size, each `width` inches wide, under their titles. The first one exists."""
    first = rows[0][0][1]
    assert first is not None
    height = width * first.shape[0] / first.shape[1]
    step, top = height + _CAPTION_IN, _CAPTION_IN if title else 0.0
    size = max(map(len, rows)) * (width + _GAP_IN) + _GAP_IN, top + len(rows) * step + _GAP_IN
    figure = Figure(figsize=size, dpi=dpi, facecolor="white")
    figure.text(0.006, 1 - _CAPTION_IN / size[1], plain(title, 160), va="center", fontsize=11, parse_math=False)
    for row, pictures in enumerate(rows):
        for column, (caption, picture) in enumerate(pictures):
            left, above = _GAP_IN + column * (width + _GAP_IN), top + row * step + _CAPTION_IN
            shown = first * 0 + 236 if picture is None else picture
            add_picture(figure, left, above, width, height, shrunk(shown, round(width * dpi)), caption, 8.5)
            if picture is None:
                middle = (left + width / 2) / size[0], 1 - (above + height / 2) / size[1]
                figure.text(*middle, "not on this scale", ha="center", va="center", fontsize=9)
    file = io.BytesIO()
    figure.savefig(file, format=form, **options)
    return file.getvalue()


def draw_gallery(clean: Frame, cells: Sequence[GalleryCell], title: str, form: str) -> bytes:
    """Draw the clean frame and one picture per cell as a PNG or PDF figure, with three (for wide frames) to five
    pictures per row."""
    ratio = clean.shape[0] / clean.shape[1]
    columns = min(len(cells) + 1, 3 if ratio < 0.4 else 4 if ratio < 0.6 else 5)
    shown: list[_Titled] = [("clean", clean)]
    shown += [
        (f"{cell.name}  {cell.caption}".rstrip(), cell.frames[cell.still] if cell.frames else None) for cell in cells
    ]
    rows = [shown[at : at + columns] for at in range(0, len(shown), columns)]
    options: dict[str, Any] = {"metadata": {"CreationDate": None}} if form == "pdf" else {}
    return draw_grid(rows, (_WIDTH_IN - _GAP_IN) / columns - _GAP_IN, form, title, **options)


def _draw_webp(rows: Sequence[Sequence[_Titled]], width: float, quality: int) -> bytes:
    return draw_grid(rows, width, "webp", dpi=130, pil_kwargs={"quality": quality, "method": 6})


def draw_strip(
    sample: Sample,
    predict: Callable[[Frame, Frame], Flow],
    corruptions: Sequence[Corruption],
    severity: int,
    model: str,
    seed: int = 0,
) -> bytes:
    """Draw a WebP picture of a model on the clean pair and on each corrupted version of it, a column each: the first
    frame that changed, the flow on a common colour scale, and the end-point errors."""
    pair = sample.frames[:2]
    shown: list[tuple[str, Frame, Flow, bool]] = [("clean", pair[0], predict(pair[0], pair[1]), True)]
    for corruption in corruptions:
        first, second = corrupt_clip(pair, corruption, severity, seed, sample.key, depth=sample.depth)
        frame = second if np.array_equal(first, pair[0]) else first
        shown.append((corruption.name, frame, predict(first, second), corruption.truth != "none"))
    truth, valid = (shown[0][2], None) if sample.flow is None else (sample.flow, sample.valid)
    radius = flow_radius(truth, valid)
    what, decimals = f"{model}, error" if sample.flow is not None else f"{model}, change", 1
    if sample.flow is not None and not sample.flow.any():
        radius = max(flow_radius(flow) for _, _, flow, _ in shown)
        what, decimals = f"{model}, phantom motion", 3
    rows: tuple[list[_Titled], ...] = ([], [], [])
    for place, (title, frame, flow, has_truth) in enumerate(shown):
        errors = epe_map(flow, truth)
        if valid is not None:
            errors = np.where(valid, errors, np.nan)
        mean = f"{float(np.nanmean(errors)):.{decimals}f} px"
        if sample.flow is not None and not has_truth:
            errors, mean = np.full_like(errors, np.nan), "no ground truth"
        colours = thickened(error_colours(errors), ~np.isnan(errors))
        rows[0].append((title, frame))
        rows[1].append(("" if place else "flow", flow_colours(flow, radius)))
        rows[2].append((mean if place else f"{what} {mean}", colours))
    return _draw_webp(rows, 2.0, 82)


def draw_attacks(clean: Frame, attacked: Sequence[Attacked], model: str) -> bytes:
    """Draw a WebP picture with one row per attack: attacked frame 1, its change magnified around mid-grey, and the flow
    before and after the attack.
    """
    rows: list[list[_Titled]] = []
    for one in attacked:
        change, factor = magnified(clean, one.frames[0])
        radius = flow_radius(one.clean_flow)
        warned = " (with a warning)" if one.warnings else ""
        rows.append(
            [
                (f"{one.attack}, {one.budget:g} grey levels {one.norm}{warned}", one.frames[0]),
                (f"change of frame 1, magnified by {factor:g}", change),
                (f"{model}, clean frames", flow_colours(one.clean_flow, radius)),
                (f"{model}, attacked: flow changed by {one.moved:.2f} px", flow_colours(one.flow, radius)),
            ]
        )
    return _draw_webp(rows, 2.8, 85)


def magnified(clean: Frame, attacked: Frame) -> tuple[Frame, float]:
    """Return the change of a frame, magnified around mid-grey, and the magnification; uniform grey and 1 if nothing
    changed.

    >>> picture, factor = magnified(np.zeros((1, 2, 3), np.uint8), np.array([[[4, 0, 2], [0, 0, 0]]], np.uint8))
    >>> picture.tolist(), factor
    ([[[228, 128, 178], [128, 128, 128]]], 25.0)
    """
    change = attacked.astype(np.int16) - clean
    largest = int(np.abs(change).max())
    factor = max(_REACH / largest, 1.0) if largest else 1.0
    return np.clip(np.rint(_GREY + factor * change), 0, 255).astype(np.uint8), factor
