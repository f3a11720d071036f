"""A model at a glance: the frame, the flow and its errors under each corruption, and what each attack does to them."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ...attacks.result import Attacked
from ...corruptions import Corruption, corrupt_clip
from ...figure_style import add_picture, default_style
from ...images.error_colours import error_colours
from ...images.flow_colours import flow_colours, flow_radius
from ...images.io import shrunk
from ...images.sparse import thickened
from ...metrics.error_maps import epe_map
from ...sample import Flow, Frame, Sample, SceneDepth

_CAPTION_IN = 0.22
_MARGIN_IN = 0.04
_DPI = 130
_GREY = 128
_REACH = 100
"""Distance from middle grey of the largest change in a picture."""

_Cells = dict[tuple[int, int], tuple[str, Frame]]
"""(row, column) -> title and picture, RGB uint8 (H, W, 3)."""


@dataclass(frozen=True)
class StripColumn:
    """One condition.

    Attributes:
        title: "clean", or the corruption.
        frame: the frame that is shown, RGB uint8 (H, W, 3).
        flow: float32 (H, W, 2), pixels, what the model predicts under it.
    """

    title: str
    frame: Frame
    flow: Flow


def strip_columns(
    pair: Sequence[Frame], predict: Callable[[Frame, Frame], Flow], corruptions: Sequence[Corruption],
    severity: int, seed: int = 0, key: str = "", depth: SceneDepth | None = None,
) -> list[StripColumn]:  # fmt: skip
    """The clean pair and each corruption of it at a severity, with the model's flow.

    Of the two frames the first that the corruption changes is shown.

    Args:
        pair: two frames, RGB uint8 (H, W, 3).
        predict: of the model.
        corruptions: loaded.
        severity: 1 to 5.
        seed, key: of the draws.
        depth: of the pair, for corruptions that need it.
    """
    columns = [StripColumn("clean", pair[0], predict(pair[0], pair[1]))]
    for corruption in corruptions:
        first, second = corrupt_clip(pair, corruption, severity, seed, key, depth=depth)
        shown = second if np.array_equal(first, pair[0]) else first
        columns.append(StripColumn(corruption.name, shown, predict(first, second)))
    return columns


@default_style()
def draw_strip(sample: Sample, columns: Sequence[StripColumn], model: str) -> bytes:
    """A picture of three rows: frames, flows in one scale of colours, end-point errors; a WebP file.

    Args:
        sample: the clean pair; errors are relative to its ground truth or, if it has none, to the first column's flow.
            Where nothing moves in it, they are phantom motion.
        columns: the clean frames first.
        model: its name, for the captions.

    Returns:
        The file's bytes, the same for the same arguments.
    """
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
        first = place == 0
        cells |= {
            (0, place): (column.title, column.frame),
            (1, place): ("flow" if first else "", flow_colours(column.flow, radius)),
            (2, place): (f"{what} {mean}" if first else mean, thickened(error_colours(errors), ~np.isnan(errors))),
        }
    return _grid(cells, 2.0, 82)


@default_style()
def draw_attacks(clean: Frame, attacked: Sequence[Attacked], model: str) -> bytes:
    """A row for each attack: attacked frame 1, its change magnified around grey, flow before and after; a WebP file.

    Args:
        clean: frame 1, RGB uint8 (H, W, 3).
        attacked: results of attacks on the pair.
        model: its name, for the captions.

    Returns:
        The file's bytes, the same for the same arguments.
    """
    cells: _Cells = {}
    for row, one in enumerate(attacked):
        change, factor = magnified(clean, one.frames[0])
        radius = flow_radius(one.clean_flow)
        warned = " (with a warning)" if one.warnings else ""
        cells |= {
            (row, 0): (f"{one.attack}, {one.budget:g} grey levels {one.norm}{warned}", one.frames[0]),
            (row, 1): (f"change of frame 1, times {factor:g}", change),
            (row, 2): (f"{model}, clean frames", flow_colours(one.clean_flow, radius)),
            (row, 3): (f"{model}, attacked: moved by {one.moved:.2f} px", flow_colours(one.flow, radius)),
        }
    return _grid(cells, 2.8, 85)


def magnified(clean: Frame, attacked: Frame) -> tuple[Frame, float]:
    """The change of a frame around grey, and its magnification; grey and 1 for an unchanged frame.

    >>> picture, factor = magnified(np.zeros((1, 2, 3), np.uint8), np.array([[[4, 0, 2], [0, 0, 0]]], np.uint8))
    >>> picture.tolist(), factor
    ([[[228, 128, 178], [128, 128, 128]]], 25.0)
    """
    change = attacked.astype(np.int16) - clean
    largest = int(np.abs(change).max())
    factor = max(_REACH / largest, 1.0) if largest else 1.0
    return np.clip(np.rint(_GREY + factor * change), 0, 255).astype(np.uint8), factor


def _grid(cells: _Cells, width: float, quality: int) -> bytes:
    """Pictures of one size under their titles, as a WebP file.

    Args:
        cells: of the picture.
        width: of a picture, inches.
        quality: of the encoding, 1 to 100.
    """
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
