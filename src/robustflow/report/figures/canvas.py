"""Create figures without global state, with comparable axes, placed names and labelled marks; write them to files."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from ...core.display import default_style
from ...core.errors import unknown_name
from ...core.files import make_folder, write_bytes
from ...core.text import name_text
from ...stats.intervals import IntervalEnds
from ..table import interval_text
from .styles import GRID, KeyEntry, LegendPlace, legend_handles

FILE_FORMATS = ("png", "svg", "pdf")
_LEGEND_PT = 8


@contextmanager
def any_script() -> Iterator[None]:
    """Suppress matplotlib's warning about missing glyphs where text is only measured, or rendered with the reader's
    fonts."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ ", UserWarning)
        yield


@default_style()
def settle_layout(figure: Figure) -> None:
    """Compute the layout of a figure without drawing it, and keep it: names placed afterwards do not move the panels,
    and the bytes do not depend on how often the figure is drawn."""
    engine = figure.get_layout_engine()
    if engine is not None:
        with any_script():
            engine.execute(figure)
        figure.set_layout_engine(None)  # the layout engine "none" would draw everything twice to measure it


@default_style()
def figure_bytes(figure: Figure, format: str, live_text: bool = False) -> bytes:
    """Encode a figure as "png" (200 dpi), "svg" or "pdf"; equal figures give equal bytes."""
    if format not in FILE_FORMATS:
        raise unknown_name("figure format", format, FILE_FORMATS)
    settle_layout(figure)
    metadata: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[format]
    out = io.BytesIO()
    outlines = "none" if live_text else "path"
    settings: Any = {"svg.hashsalt": "robustflow", "svg.fonttype": outlines, "pdf.fonttype": 42}
    with rc_context(settings), any_script() if live_text else nullcontext():
        figure.savefig(out, format=format, dpi=200, metadata=metadata)
    return out.getvalue()


def write_figures(figures: Mapping[str, Figure], folder: Path, formats: tuple[str, ...] = FILE_FORMATS) -> list[Path]:
    """Write each figure in each format to FOLDER/<name>.<format>."""
    make_folder(folder)
    paths = []
    for name, figure in figures.items():
        for format in formats:
            paths.append(folder / f"{name}.{format}")
            write_bytes(paths[-1], figure_bytes(figure, format))
    return paths


@dataclass(frozen=True)
class Mark:
    """A point, bar or name in a figure."""

    model: str
    setting: str = ""
    values: tuple[tuple[str, str], ...] = ()


class MarkedFigure(Figure):
    """A figure together with the meaning of its marks."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.marks: dict[str, tuple[Mark, ...]] = {}
        self.caption = ""
        self.key: tuple[KeyEntry, ...] = ()

    def explain(self, key: Sequence[KeyEntry], legend: LegendPlace = "") -> int:
        """Set the key, and draw it as a legend if a place is given; return the legend's number of lines."""
        self.key = tuple(key)
        if not key or legend == "":
            return 0
        widest = 0.6 * _LEGEND_PT * max(len(name_text(label)) for label, _, _ in key) + 40  # in points, with the marker
        columns = max(1, min(4, len(key), int(72 * self.get_figwidth() // widest)))
        self.legend(handles=legend_handles(key), loc=legend, ncols=columns, frameon=False, fontsize=_LEGEND_PT)
        return -(-len(key) // columns)

    def _repr_png_(self) -> bytes:
        """Return the figure as a PNG for notebooks, regardless of the matplotlib backend."""
        return figure_bytes(self, "png")

    def mark(self, artist: Artist, marks: Sequence[Mark]) -> None:
        """Record the meaning of an artist's points; a bar or a text has a single mark."""
        name = f"mark-{len(self.marks)}"
        artist.set_gid(name)
        self.marks[name] = tuple(marks)


LEAST_PX = 1.0
"""Minimum span of an error axis, in pixels, so that a difference of 0.1 px does not look large."""

LONGEST_NAME = 30
"""Maximum number of characters of a name next to a point, before the number that follows it."""

_NAME_SIZE = 7.5
_OVERLAP = 10.0
"""Cost of two overlapping names."""
_MISREAD = 4.0
"""Cost of a name that is nearer to a different marker than to its own."""

_ALIGN = {"left": 0.0, "center": 0.5, "right": 1.0}
_Place = tuple[tuple[float, float], Literal["left", "center", "right"]]


def new_figure(
    width: float, height: float, panels: int = 1, columns: int = 3, above: float = 0.0
) -> tuple[MarkedFigure, list[Axes]]:
    """Create a figure with panels of `width` x `height` inches, at most `columns` in a row, and `above` inches for a
    legend."""
    columns = min(columns, panels)
    rows = -(-panels // columns)
    figure = MarkedFigure(figsize=(width * columns, height * rows + above), layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(rows, columns, index + 1) for index in range(panels)]
    for one in axes:
        one.grid(True, color=GRID, linewidth=0.6)
        one.set_axisbelow(True)
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def fair_limits(
    values: Iterable[float],
    least: float = LEAST_PX,
    *,
    ends: Iterable[float] = (),
    zero: bool = False,
    room: float = 0.08,
) -> tuple[float, float]:
    """Choose the limits of a linear axis so that small differences do not look large: the span is at least the larger
    of `least` and a quarter of the largest value. The `ends` of intervals extend it on each side by at most the largest
    value or the span of the values.

    >>> fair_limits([2.5, 2.75], room=0)
    (2.125, 3.125)
    >>> fair_limits([0.02, 0.11], zero=True, room=0)
    (0.0, 1.0)
    >>> fair_limits([1.0, 2.0], ends=[0.5, 900], zero=True, room=0)
    (0.0, 4.0)
    """
    known = [*values, *([0.0] if zero else [])]
    low, high = min(known), max(known)
    reach = max(least, high - low, abs(low), abs(high))
    known += np.clip([*ends], low - reach, high + reach).tolist()
    low, high = min(known), max(known)
    missing = max(least, 0.25 * max(abs(low), abs(high))) - (high - low)
    if missing > 0:
        below = 0.0 if zero and low == 0 else missing if zero and high == 0 else missing / 2
        below = min(below, low) if low >= 0 else below
        low, high = low - below, high + missing - below
    space = room * (high - low)
    return low - (0.0 if zero and low == 0 else space), high + (0.0 if zero and high == 0 else space)


def ends_text(ends: IntervalEnds | None) -> str:
    """Format an interval as " [1.02, 1.71]"; "" if there is none."""
    return "" if ends is None else f" {interval_text(ends)}"


WITH_INTERVALS = "Whiskers are 95 % confidence intervals; long ones end at the edge."


def spread_labels(axes: Axes, points: list[tuple[float, float, str]], radii: Sequence[float]) -> list[Annotation]:
    """Place names next to their points, whose markers have `radii` in points, at the position with the least overlap
    with names and points already placed. A line connects a name with its point if a different marker is nearer. Names
    that would overlap everywhere are omitted.
    """
    figure = axes.figure
    assert isinstance(figure, Figure)
    axes.get_xlim()  # sets the limits of both axes from the data
    per_point = figure.dpi / 72
    centres = np.array([axes.transData.transform((x, y)) for x, y, _ in points])
    edges = np.array(radii) * per_point
    placed = np.empty((0, 2, 2))  # lower left and upper right corner of each name drawn so far
    texts = []
    for index, ((x, y, label), dot, radius) in enumerate(zip(points, centres, radii, strict=True)):
        text = axes.annotate(
            name_text(label), (x, y), (0, 0), textcoords="offset points", va="center", fontsize=_NAME_SIZE
        )
        with any_script():
            size = text.get_window_extent()
        places = _places(radius)
        offsets = np.array([place for place, _ in places]) * per_point
        align = np.array([_ALIGN[side] for _, side in places])
        low = dot + offsets - np.stack([align * size.width, np.full(len(places), size.height / 2)], axis=1)
        boxes = np.stack([low, low + np.array((size.width, size.height))], axis=1)[:, None]  # place, 1, corner, axis
        overlaps = (placed[:, 0] <= boxes[..., 1, :]) & (placed[:, 1] >= boxes[..., 0, :])
        covered = (centres >= boxes[..., 0, :]) & (centres <= boxes[..., 1, :])
        outside = (boxes[:, 0, 0] < axes.bbox.min) | (boxes[:, 0, 1] > axes.bbox.max)
        gaps = np.linalg.norm(centres - np.clip(centres, boxes[..., 0, :], boxes[..., 1, :]), axis=-1) - edges
        misread = gaps.min(axis=1) < gaps[:, index]
        cost = 0.1 * np.arange(len(places)) + _OVERLAP * overlaps.all(axis=-1).sum(axis=1)
        cost += 3.0 * covered.all(axis=-1).sum(axis=1) + 20.0 * outside.any(axis=1)
        cost += _MISREAD * misread + np.minimum(3, (gaps < 0).sum(axis=1))
        best = int(cost.argmin())
        text.set_position(places[best][0])
        text.set_horizontalalignment(places[best][1])
        texts.append(text)
        if cost[best] >= _OVERLAP:
            text.set_visible(False)
            continue
        placed = np.concatenate([placed, boxes[best]])
        if misread[best]:
            ends = axes.transData.inverted().transform((dot, np.clip(dot, *boxes[best, 0]))).T
            axes.plot(*ends, color=text.get_color(), linewidth=0.5, scalex=False, scaley=False)
    return texts


def _places(radius: float) -> list[_Place]:
    """List candidate positions of a name around a marker, best first: offset (right, up) in points, and the
    alignment."""
    places: list[_Place] = []
    for reach in (radius + 3, radius + 11, radius + 20, radius + 32, radius + 46, radius + 62):
        slant, up = 0.8 * reach, reach + 2
        places += [((reach, 0.0), "left"), ((-reach, 0.0), "right"), ((0.0, up), "center"), ((0.0, -up), "center")]
        places += [((slant, slant), "left"), ((-slant, slant), "right")]
        places += [((slant, -slant), "left"), ((-slant, -slant), "right")]
    return places
