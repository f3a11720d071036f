"""Curves of a metric by severity, with one panel per corruption, one line per run, and confidence bands. Security
curves: error by attack budget, with one panel per norm. Sparsification curves: the error after removing the
least confident pixels, with one panel per family and one line per severity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import polars as pl
from matplotlib.lines import Line2D

from ...core.arguments import SEVERITIES
from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text
from ...corruptions.registry import ordered
from ...metrics.means import Means
from ...stats.attacks import CurvePoint
from ...stats.results import FAMILY_LABELS, METRIC_LABELS, UNITS, long_label, metric_label
from ...stats.uncertainty import intervals
from .canvas import LEAST_PX, Mark, MarkedFigure, ends_text, fair_limits, new_figure
from .crer_by_family import LEAST_CRER
from .styles import MODEL_STYLES, Style, distinct_styles, model_styles

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


NORMS = {"linf": "largest change", "rms": "root mean square of the change", "area": "share of the pixels"}


@default_style()
def security_figure(points: Sequence[CurvePoint]) -> MarkedFigure:
    """Plot the security curves of a run; hollow markers indicate a warning."""
    if not points:
        raise UsageError("this run has no attacks and therefore no security curves; run it again with --attacks")
    styles = model_styles(point.attack for point in points)
    norms = [norm for norm in NORMS if any(point.norm == norm for point in points)]
    figure, axes = new_figure(4.4, 3.4, len(norms))
    metric = points[0].metric
    reached = [end for point in points for end in (point.error, point.high) if end is not None]
    for panel, norm in zip(axes, norms, strict=True):
        budgets = sorted({point.budget for point in points if point.norm == norm})
        places = {budget: place for place, budget in enumerate(budgets)}
        for name in dict.fromkeys(point.attack for point in points if point.norm == norm):
            curve, style = [point for point in points if point.attack == name], styles[name]
            at = [places[point.budget] for point in curve]
            errors = [point.error for point in curve]
            panel.plot(at, errors, color=style.colour, linewidth=1.2)
            for place, point in zip(at, curve, strict=True):
                fill = "white" if point.warned else style.colour
                drawn = panel.plot(
                    place, point.error, color=style.colour, marker=style.marker, markersize=4.5, markerfacecolor=fill
                )
                figure.mark(drawn[0], [_mark_of_security_curves(point)])
            known = [(place, p.low, p.high) for place, p in zip(at, curve, strict=True) if p.low is not None]
            if known:
                where, low, high = zip(*known, strict=True)
                panel.fill_between(where, low, high, color=style.colour, alpha=0.12, linewidth=0)
        panel.set_xticks(list(places.values()), [f"{budget:g}" for budget in budgets])
        panel.set_ylim(fair_limits([0.0, *reached], zero=True))
        panel.set_title(NORMS[norm], fontsize=9)
        panel.set_xlabel("budget (%)" if norm == "area" else "budget (grey levels)", fontsize=8.5)
        panel.set_ylabel(metric_label(metric), fontsize=8.5)
    key = [(name_text(name), style, True) for name, style in styles.items()]
    figure.explain(key, legend=False)
    banded = any(point.low is not None for point in points)
    figure.caption = (
        f"{metric_label(metric)} by budget of each attack; budget 0 refers to the clean frames, and budgets are not "
        "to scale. A steeper curve means a less robust model. Hollow markers indicate a warning."
    ) + (" Bands are 95 % confidence intervals." if banded else "")
    return figure


def _mark_of_security_curves(point: CurvePoint) -> Mark:
    ends = None if point.low is None or point.high is None else (point.low, point.high)
    value = f"{point.error:.2f} px{ends_text(ends)}"
    where = (("norm", point.norm), ("budget", f"{point.budget:g}"))
    warning = "yes" if point.warned else "no"
    return Mark(point.attack, "", (*where, (METRIC_LABELS[point.metric], value), ("warning", warning)))


_REMOVED = tuple(range(0, 100, 10))
_COLUMNS_SPARSIFICATION_CURVES = 4


@default_style()
def sparsification_curves(model: str, known: Means) -> MarkedFigure:
    """Plot the mean error of the remaining pixels when 0, 10, ... 90 % are removed: least confident first (solid), and
    largest errors first (dashed). All panels have the same axes.
    """
    drawn = {
        (family, level): _curves(known, family, level)
        for family in FAMILY_LABELS
        for level in SEVERITIES
        if ("ause", family, level) in known
    }
    families = list(dict.fromkeys(family for family, _ in drawn))
    if not families:
        raise UsageError("there is no sparsification curve: the run has no confidence or no ground truth")
    figure, axes = new_figure(2.6, 2.3, len(families), _COLUMNS_SPARSIFICATION_CURVES, above=0.3)
    levels = sorted({level for _, level in drawn})
    styles = dict(zip(levels, MODEL_STYLES, strict=False))
    for panel, family in zip(axes, families, strict=True):
        for level in (level for name, level in drawn if name == family):
            (errors, oracle), style = drawn[family, level], styles[level]
            panel.plot(_REMOVED, oracle, color=style.colour, linewidth=1.0, linestyle=(0, (3, 2)))
            (line,) = panel.plot(
                _REMOVED, errors, color=style.colour, marker=style.marker, markersize=3.5, linewidth=1.2
            )
            where = (("class", FAMILY_LABELS[family]), ("severity", str(level)))
            shown = zip(_REMOVED, errors, oracle, strict=True)
            figure.mark(line, [Mark(model, "", (*where, *_sparsification_texts(*numbers))) for numbers in shown])
        panel.set_title(FAMILY_LABELS[family], fontsize=9)
        panel.set_xlabel("removed (%)", fontsize=8)
        panel.tick_params(labelsize=7.5)
    highest = [value for curves in drawn.values() for curve in curves for value in curve]
    for panel in axes:
        panel.set_ylim(fair_limits(highest, LEAST_PX, zero=True))
    axes[0].set_ylabel("EPE of remaining pixels (px)", fontsize=8)
    figure.explain([(f"severity {level}", style, True) for level, style in styles.items()], legend=False)
    figure.caption = (
        f"{model}: mean error of the remaining pixels after removing the least confident ones; dashed: after removing "
        "those with the largest errors. The area between the two is AUSE."
    )
    return figure


def _curves(known: Means, family: str, level: int) -> tuple[list[float], list[float]]:
    """Return the errors of the remaining pixels, least confident and largest errors removed first."""
    left = [100 - removed for removed in _REMOVED]
    errors = [known[f"error_at_{share}", family, level] for share in left]
    return errors, [errors[0], *(known[f"oracle_at_{share}", family, level] for share in left[1:])]


def _sparsification_texts(removed: int, error: float, oracle: float) -> tuple[tuple[str, str], ...]:
    return ("removed", f"{removed} %"), ("EPE", f"{error:.2f} px"), ("oracle", f"{oracle:.2f} px")
