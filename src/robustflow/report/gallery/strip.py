"""Overview pictures for a model: frame, flow and errors under each corruption or attack."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ...attacks.result import Attacked
from ...core.display import add_picture, default_style
from ...core.types import Flow, Frame, Sample
from ...corruptions import Corruption, corrupt_clip
from ...media.colours import error_colours, flow_colours, flow_radius, thickened
from ...media.images import shrunk
from ...metrics.error_maps import epe_map

_CAPTION_IN = 0.22
_MARGIN_IN = 0.04
_DPI = 130
_GREY = 128
_REACH = 100
"""Distance in grey levels between mid-grey and the largest change in a picture."""

_Cells = dict[tuple[int, int], tuple[str, Frame]]
"""Title and picture, RGB uint8 (H, W, 3), by (row, column)."""


@dataclass(frozen=True)
class StripColumn:
    """A column of the picture, which shows one condition."""

    title: str
    frame: Frame
    flow: Flow
    has_truth: bool = True


def strip_columns(
    sample: Sample,
    predict: Callable[[Frame, Frame], Flow],
    corruptions: Sequence[Corruption],
    severity: int,
    seed: int = 0,
) -> list[StripColumn]:
    """Predict the flow of the clean pair and of each corrupted version of it at one severity."""
    pair = sample.frames[:2]
    columns = [StripColumn("clean", pair[0], predict(pair[0], pair[1]))]
    for corruption in corruptions:
        first, second = corrupt_clip(pair, corruption, severity, seed, sample.key, depth=sample.depth)
        shown = second if np.array_equal(first, pair[0]) else first
        columns.append(StripColumn(corruption.name, shown, predict(first, second), corruption.truth != "none"))
    return columns


@default_style()
def draw_strip(sample: Sample, columns: Sequence[StripColumn], model: str) -> bytes:
    """Draw a WebP picture with three rows: frames, flows on a common colour scale, and end-point errors."""
    truth, valid = (columns[0].flow, None) if sample.flow is None else (sample.flow, sample.valid)
    radius = flow_radius(truth, valid)
    what, decimals = f"{model}, error" if sample.flow is not None else f"{model}, change", 1
    if sample.flow is not None and not sample.flow.any():
        radius = max(flow_radius(column.flow) for column in columns)
        what, decimals = f"{model}, phantom motion", 3
    cells: _Cells = {}
    for place, column in enumerate(columns):
        errors = epe_map(column.flow, truth)
        if valid is not None:
            errors = np.where(valid, errors, np.nan)
        mean = f"{float(np.nanmean(errors)):.{decimals}f} px"
        if sample.flow is not None and not column.has_truth:
            errors, mean = np.full_like(errors, np.nan), "no ground truth"
        first = place == 0
        cells |= {
            (0, place): (column.title, column.frame),
            (1, place): ("flow" if first else "", flow_colours(column.flow, radius)),
            (2, place): (f"{what} {mean}" if first else mean, thickened(error_colours(errors), ~np.isnan(errors))),
        }
    return _grid(cells, 2.0, 82)


@default_style()
def draw_attacks(clean: Frame, attacked: Sequence[Attacked], model: str) -> bytes:
    """Draw a WebP picture with one row per attack: attacked frame 1, its change magnified around mid-grey, and the flow
    before and after the attack.
    """
    cells: _Cells = {}
    for row, one in enumerate(attacked):
        change, factor = magnified(clean, one.frames[0])
        radius = flow_radius(one.clean_flow)
        warned = " (with a warning)" if one.warnings else ""
        cells |= {
            (row, 0): (f"{one.attack}, {one.budget:g} grey levels {one.norm}{warned}", one.frames[0]),
            (row, 1): (f"change of frame 1, magnified by {factor:g}", change),
            (row, 2): (f"{model}, clean frames", flow_colours(one.clean_flow, radius)),
            (row, 3): (f"{model}, attacked: flow changed by {one.moved:.2f} px", flow_colours(one.flow, radius)),
        }
    return _grid(cells, 2.8, 85)


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


def _grid(cells: _Cells, width: float, quality: int) -> bytes:
    """Arrange pictures of equal size under their titles, as a WebP file."""
    rows, columns = (1 + max(place[axis] for place in cells) for axis in (0, 1))
    tall, wide = cells[0, 0][1].shape[:2]
    height = width * tall / wide
    step = height + _CAPTION_IN
    size = (columns * (width + _MARGIN_IN) + _MARGIN_IN, rows * step + _MARGIN_IN)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
    for (row, column), (title, picture) in cells.items():
        left, top = _MARGIN_IN + column * (width + _MARGIN_IN), row * step + _CAPTION_IN
        add_picture(figure, left, top, width, height, shrunk(picture, round(width * _DPI)), title, 8)
    file = io.BytesIO()
    figure.savefig(file, format="webp", pil_kwargs={"quality": quality, "method": 6})
    return file.getvalue()
