"""Curves of a metric by severity, with one panel per corruption, one line per run, and confidence bands."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import polars as pl
from matplotlib.lines import Line2D

from ...analysis.labels import METRIC_LABELS, UNITS, long_label, metric_label
from ...analysis.uncertainty import intervals
from ...corruptions.names import ordered
from ...errors import UsageError
from ...figure_style import default_style
from ...severity import SEVERITIES
from ...text import name_text
from .canvas import LEAST_PX, ends_text, fair_limits, new_figure
from .crer_by_family import LEAST_CRER
from .marks import Mark, MarkedFigure
from .styles import MODEL_STYLES, Style, distinct_styles

_COLUMNS = 5
_LEGEND_PT = 8


@default_style()
def severity_curves(
    runs: Mapping[str, pl.DataFrame],
    metric: str = "rcre",
    styles: Mapping[str, Style] = MappingProxyType({}),
    *,
    legend: bool = True,
) -> MarkedFigure:
    """Plot a metric by severity for each corruption, with 95 % intervals if there are enough images. All panels have
    the same axes.
    """
    if len(runs) > len(MODEL_STYLES):
        raise UsageError(f"{len(runs)} runs in one figure cannot be distinguished: choose up to {len(MODEL_STYLES)}")
    styles = distinct_styles({name: styles.get(name) for name in runs})
    curves = {
        name: intervals(rows, severities=True, metrics=[metric]).filter(pl.col("severity").is_not_null())
        for name, rows in runs.items()
    }
    corruptions = {corruption for curve in curves.values() for corruption in curve["corruption"]}
    if not corruptions:
        raise UsageError(f"none of these runs measured {METRIC_LABELS.get(metric, metric)} at any severity")
    shown = ordered(corruptions)
    figure, axes = new_figure(2.3, 1.9, len(shown), _COLUMNS, above=0.5)
    figure.set_layout_engine(None)  # panels of equal size do not need a layout engine, which is slow
    banded = False
    for panel, corruption in zip(axes, shown, strict=True):
        for name, curve in curves.items():
            style, line = styles[name], curve.filter(corruption=corruption).sort("severity")
            drawn = panel.plot(
                line["severity"],
                line["estimate"],
                color=style.colour,
                marker=style.marker,
                markersize=3.5,
                markeredgewidth=0,
                linewidth=1.2,
            )
            figure.mark(drawn[0], [_mark(name, metric, row) for row in line.iter_rows(named=True)])
            known = line.drop_nulls(["low", "high"])
            if known.height:
                banded = True
                panel.fill_between(
                    known["severity"], known["low"], known["high"], color=style.colour, alpha=0.15, linewidth=0
                )
        panel.set_title(
            name_text(long_label(corruption)), fontsize=8.5, y=1
        )  # fixed positions keep the title out of the layout; the coordinates below do the same for the labels
        panel.xaxis.set_label_coords(0.5, 0)
        panel.yaxis.set_label_coords(0, 0.5)
        panel.set_xticks(SEVERITIES)
        panel.set_xlim(0.7, 5.3)
        panel.tick_params(labelsize=7.5)
    scale_panels(figure, LEAST_CRER if metric == "crer" else LEAST_PX)
    width, height = figure.get_size_inches()
    figure.supylabel(metric_label(metric), fontsize=9, x=0.08 / width, ha="left")
    figure.supxlabel("severity", fontsize=9, y=0.06 / height, va="bottom")
    key = [(name, styles[name], True) for name in curves]
    figure.explain(key, legend=False)
    above = 0.3
    if legend:
        above += 0.17 * _legend(figure)
    figure.caption = f"{metric_label(metric)} by severity, with a panel per corruption and shared axes." + (
        " Bands are 95 % confidence intervals." if banded else ""
    )
    figure.subplots_adjust(0.62 / width, 0.45 / height, 1 - 0.12 / width, 1 - above / height, 0.24, 0.34)
    return figure


def _legend(figure: MarkedFigure) -> int:
    """Draw the legend above the panels; return its number of lines."""
    handles = [
        Line2D([], [], color=style.colour, marker=style.marker, markersize=3.5, label=name_text(name))
        for name, style, _ in figure.key
    ]
    widest = (
        max(len(str(handle.get_label())) for handle in handles) * 0.6 * _LEGEND_PT + 40
    )  # in points, including the line sample
    columns = max(1, min(4, len(handles), int(72 * figure.get_figwidth() // widest)))
    figure.legend(handles=handles, loc="upper center", ncols=columns, frameon=False, fontsize=_LEGEND_PT)
    return -(-len(handles) // columns)


@default_style()
def scale_panels(figure: MarkedFigure, least: float = LEAST_PX, *, apart: bool = False) -> None:
    """Set the limits of the vertical axes from the curves of all panels or, with `apart`, of each panel separately.
    Each axis starts at 0 unless a value is negative, and spans at least `least`."""
    together = [end for axes in figure.axes for end in axes.dataLim.intervaly]
    for axes in figure.axes:
        axes.set_ylim(fair_limits(axes.dataLim.intervaly if apart else together, least, zero=True))


def _mark(name: str, metric: str, row: dict[str, Any]) -> Mark:
    interval = ends_text(None if row["low"] is None else (row["low"], row["high"]))
    where = (("corruption", long_label(row["corruption"])), ("severity", str(row["severity"])))
    value = f"{row['estimate']:.2f} {UNITS[metric]}".strip() + interval
    return Mark(name, "", (*where, (METRIC_LABELS[metric], value)))
