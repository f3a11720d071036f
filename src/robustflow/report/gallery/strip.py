"""A model under corruptions at a glance: a column for each, with the frame, the flow and its errors."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ...corruptions import Corruption, corrupt_clip
from ...figure_style import add_picture, default_style
from ...images.error_colours import error_colours
from ...images.flow_colours import flow_colours, flow_radius
from ...images.io import shrunk
from ...images.sparse import thickened
from ...metrics.error_maps import epe_map
from ...sample import Flow, Frame, Sample, SceneDepth

_COLUMN_IN = 2.0
_CAPTION_IN = 0.22
_MARGIN_IN = 0.04
_DPI = 130
_QUALITY = 82


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
        columns: the clean frames first.
        model: its name, for the captions.

    Returns:
        The file's bytes, the same for the same arguments.
    """
    truth, valid = (columns[0].flow, None) if sample.flow is None else (sample.flow, sample.valid)
    radius = flow_radius(truth, valid)
    what = f"{model}, error" if sample.flow is not None else f"{model}, change"
    height, width = columns[0].frame.shape[:2]
    picture = _COLUMN_IN * height / width
    step = picture + _CAPTION_IN
    size = (len(columns) * (_COLUMN_IN + _MARGIN_IN) + _MARGIN_IN, 3 * step + _MARGIN_IN)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
    for place, column in enumerate(columns):
        errors = epe_map(column.flow, truth)
        if valid is not None:
            errors = np.where(valid, errors, np.nan)
        error = thickened(error_colours(errors), ~np.isnan(errors))
        mean = float(np.nanmean(errors))
        first = place == 0
        rows = (
            (column.title, column.frame),
            ("flow" if first else "", flow_colours(column.flow, radius)),
            (f"{what} {mean:.1f} px" if first else f"{mean:.1f} px", error),
        )
        for row, (title, shown) in enumerate(rows):
            left, top = _MARGIN_IN + place * (_COLUMN_IN + _MARGIN_IN), row * step + _CAPTION_IN
            add_picture(figure, left, top, _COLUMN_IN, picture, shrunk(shown, round(_COLUMN_IN * _DPI)), title, 8)
    file = io.BytesIO()
    figure.savefig(file, format="webp", pil_kwargs={"quality": _QUALITY, "method": 6})
    return file.getvalue()
