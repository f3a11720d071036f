"""How a metric grows with severity, a panel per corruption, a line per run, with confidence bands."""

from __future__ import annotations

from collections.abc import Mapping
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
from .canvas import SERIES, new_figure
from .marks import Mark, MarkedFigure

_COLUMNS = 5
_LEGEND_PT = 8


@default_style()
def severity_curves(runs: Mapping[str, pl.DataFrame], metric: str = "rcre", *, seed: int = 0) -> MarkedFigure:
    """A metric at each severity of each corruption, with 95 % intervals if there are enough images.

    Args:
        runs: name -> rows; at most eight.
        metric: "epe", "cre", "crer" or "rcre".
        seed: of the bootstrap.

    Raises:
        UsageError: more than eight runs, or none that measured the metric.
    """
    if len(runs) > len(SERIES):
        raise UsageError(f"{len(runs)} runs in one figure cannot be distinguished: choose up to {len(SERIES)}")
    curves = {
        name: intervals(rows, seed=seed, severities=True, metrics=[metric]).filter(pl.col("severity").is_not_null())
        for name, rows in runs.items()
    }
    corruptions = {corruption for curve in curves.values() for corruption in curve["corruption"]}
    if not corruptions:
        raise UsageError(f"none of these runs measured {METRIC_LABELS.get(metric, metric)} at a severity")
    shown = ordered(corruptions)
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = new_figure(2.3 * columns, 1.9 * rows + 0.5, rows, columns)
    figure.set_layout_engine(None)  # Equal panels need no measuring, which would take longer than drawing them.
    for extra in axes[len(shown) :]:
        extra.remove()
    for panel, corruption in zip(axes, shown, strict=False):
        for colour, (name, curve) in zip(SERIES, curves.items(), strict=False):
            line = curve.filter(corruption=corruption).sort("severity")
            drawn = panel.plot(
                line["severity"], line["estimate"], color=colour, marker="o", markersize=3, linewidth=1.2
            )
            figure.mark(drawn[0], [_mark(name, metric, row) for row in line.iter_rows(named=True)])
            known = line.drop_nulls(["low", "high"])
            if known.height:
                panel.fill_between(
                    known["severity"], known["low"], known["high"], color=colour, alpha=0.15, linewidth=0
                )
        panel.set_title(name_text(long_label(corruption)), fontsize=8)
        panel.set_xticks(SEVERITIES)
        panel.tick_params(labelsize=7)
    width, height = figure.get_size_inches()
    figure.supylabel(metric_label(metric), fontsize=9, x=0.08 / width, ha="left")
    figure.supxlabel("severity", fontsize=9, y=0.06 / height, va="bottom")
    handles = [
        Line2D([], [], color=colour, marker="o", markersize=3, label=name_text(name))
        for colour, name in zip(SERIES, curves, strict=False)
    ]
    widest = max(len(str(handle.get_label())) for handle in handles) * 0.6 * _LEGEND_PT + 40  # with its line, points
    columns = max(1, min(4, len(handles), int(72 * figure.get_figwidth() // widest)))
    figure.legend(handles=handles, loc="upper center", ncols=columns, frameon=False, fontsize=_LEGEND_PT)
    above = 0.3 + 0.17 * -(-len(handles) // columns)
    figure.subplots_adjust(0.62 / width, 0.45 / height, 1 - 0.12 / width, 1 - above / height, 0.24, 0.34)
    return figure


@default_style()
def share_scale(figure: MarkedFigure) -> None:
    """Give every panel of a figure the vertical scale that holds all of them."""
    limits = [axes.get_ylim() for axes in figure.axes]
    for axes in figure.axes:
        axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))


def _mark(name: str, metric: str, row: dict[str, Any]) -> Mark:
    interval = "" if row["low"] is None else f" [{row['low']:.2f}, {row['high']:.2f}]"
    where = (("corruption", long_label(row["corruption"])), ("severity", str(row["severity"])))
    value = f"{row['estimate']:.2f} {UNITS[metric]}".strip() + interval
    return Mark(name, "", (*where, (METRIC_LABELS[metric], value)))
