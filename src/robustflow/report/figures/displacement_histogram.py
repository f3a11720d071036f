"""The paper's figure of flow amplitudes: the distribution of flow magnitudes in each benchmark."""

from __future__ import annotations

import math
from collections.abc import Mapping

import polars as pl
from matplotlib.ticker import FuncFormatter

from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text
from .canvas import Mark, MarkedFigure, new_figure
from .styles import BLACK

MOST_LINES = 8
_DASHES: tuple[tuple[str, str], ...] = tuple(
    (colour, dash) for colour in (BLACK, "#666666") for dash in ("-", "--", ":", "-.")
)
"""Dash patterns of the lines. Colours are reserved for models in the other figures, but the lines of this figure
represent benchmarks."""


@default_style()
def displacement_figure(tables: Mapping[str, pl.DataFrame]) -> MarkedFigure:
    """Plot the share of pixels against their flow magnitude on a logarithmic axis, with a dashed line per table."""
    if len(tables) > MOST_LINES:
        raise UsageError(f"{len(tables)} histograms in one figure cannot be distinguished: choose up to {MOST_LINES}")
    tables = {label: table for label, table in tables.items() if table["share"].sum() > 0}
    if not tables:
        raise UsageError("there are no displacements to draw: no pixel in these tables has a flow")
    figure, (axes,) = new_figure(6.4, 3.6)
    right = 0.0
    for drawn, (label, table) in enumerate(tables.items()):
        colour, dash = _DASHES[drawn]
        # wide lines first, so that a hidden line remains visible on both sides of the line above it
        width = 1.3 + 0.4 * (len(tables) - 1 - drawn)
        lows, shares = table["low"].to_list(), [100 * share for share in table["share"]]
        edges = [*lows, _right_edge(table)]
        axes.stairs(shares, edges, color=colour, linestyle=dash, linewidth=width, baseline=None, label=name_text(label))
        filled = [index for index, share in enumerate(shares) if share > 0]
        centres = [(edges[index] + edges[index + 1]) / 2 for index in filled]
        dots = axes.plot(centres, [shares[index] for index in filled], "o", color=colour, markersize=2.5)
        highs = table["high"].to_list()
        figure.mark(dots[0], [_mark(label, lows[index], highs[index], shares[index]) for index in filled])
        right = max(right, edges[filled[-1] + 1])
    axes.set_yscale("log")
    axes.set_ylim(top=min(axes.get_ylim()[1], 130.0))
    axes.set_xlim(0, right)
    axes.set_xlabel("flow magnitude (px)")
    axes.set_ylabel("pixels (%)")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    figure.caption = "Share of the pixels by flow magnitude on the clean frames, on a logarithmic axis."
    figure.legend(loc="outside upper center", ncols=1 if len(tables) > 2 else 2, frameon=False, fontsize=8)
    return figure


def _right_edge(table: pl.DataFrame) -> float:
    """Return the right edge of the last bin."""
    low, high = float(table["low"][-1]), float(table["high"][-1])
    if math.isfinite(high):
        return high
    return low + (low - float(table["low"][-2]) if table.height > 1 else 1.0)


def _mark(label: str, low: float, high: float, share: float) -> Mark:
    where = f"{low:g} px and more" if math.isinf(high) else f"{low:g} to {high:g} px"
    return Mark(label, "", (("length", where), ("pixels", f"{share:.3g} %")))
