"""Curves, each with a panel per group: a metric by severity (one per corruption), security curves (error by attack
budget, one per norm), sparsification curves (one per family), and histograms of flow magnitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from ...core.arguments import SEVERITIES
from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text
from ...corruptions.registry import ordered
from ...stats.lines import Numbers
from ...stats.lines import Row as FrameRow
from ...stats.results import FAMILY_LABELS, LABELS, UNITS, long_label, metric_label
from ..attack_tables import CurvePoint
from .canvas import LEAST_PX, Mark, MarkedFigure, ends_text, fair_limits, new_figure
from .crer_by_family import LEAST_CRER
from .styles import BLACK, MODEL_STYLES, Style, distinct_styles, model_styles

_COLUMNS = 5
_BANDS = " Bands are 95 % confidence intervals; wide ones end at the edge."
MOST_LINES = 8
"""Maximum number of histograms in one figure."""
_DASHES = tuple((colour, dash) for colour in (BLACK, "#666666") for dash in ("-", "--", ":", "-."))
"""Dash patterns of histograms. Colours are reserved for models in the other figures, but these lines are benchmarks."""
NORMS = {"linf": "largest change", "rms": "root mean square of the change", "area": "share of the pixels"}
_REMOVED = tuple(range(0, 100, 10))

Ends = tuple[float | None, float | None]


def _curve(
    figure: MarkedFigure,
    panel: Axes,
    places: Sequence[float],
    values: Sequence[float],
    style: Style,
    marks: Sequence[Mark],
    ends: Sequence[Ends] = (),
    hollow: Sequence[bool] = (),
) -> bool:
    """Draw a line with a labelled marker at each place, and a band between the ends that are known; return whether
    there is a band. Hollow markers are drawn one by one."""
    look: dict[str, Any] = {"color": style.colour, "marker": style.marker, "markersize": 3.5}
    if hollow:
        panel.plot(places, values, color=style.colour, linewidth=1.2)
        for place, value, mark, empty in zip(places, values, marks, hollow, strict=True):
            (dot,) = panel.plot(place, value, **look, markerfacecolor="white" if empty else style.colour)
            figure.mark(dot, [mark])
    else:
        (line,) = panel.plot(places, values, **look, markeredgewidth=0, linewidth=1.2)
        figure.mark(line, marks)
    known = [(place, *pair) for place, pair in zip(places, ends, strict=bool(ends)) if None not in pair]
    if known:
        at, low, high = map(list, zip(*known, strict=True))
        panel.fill_between(at, low, high, color=style.colour, alpha=0.15, linewidth=0)
    return bool(known)


@default_style()
def severity_curves(
    runs: Mapping[str, Numbers],
    metric: str = "rcre",
    styles: Mapping[str, Style] = MappingProxyType({}),
    *,
    legend: bool = True,
) -> MarkedFigure:
    """Plot a metric by severity for each corruption, with its intervals, where known. All panels have the same axes."""
    if len(runs) > len(MODEL_STYLES):
        raise UsageError(f"{len(runs)} runs", f"one figure shows at most {len(MODEL_STYLES)}")
    styles = distinct_styles({name: styles.get(name) for name in runs})
    corruptions = {name for numbers in runs.values() for name in numbers.corruptions((metric,))}
    if not corruptions:
        raise UsageError(f"none of these runs measured {LABELS.get(metric, metric)} at any severity")
    shown = ordered(corruptions)
    figure, axes = new_figure(2.3, 1.9, len(shown), _COLUMNS, above=0.5)
    figure.set_layout_engine(None)  # panels of equal size do not need a layout engine, which is slow
    banded = False
    for panel, corruption in zip(axes, shown, strict=True):
        for name, numbers in runs.items():
            rows = [row for at in SEVERITIES if (row := numbers.get((metric, corruption, at))) is not None]
            places, values = ([row[key] for row in rows] for key in ("severity", "value"))
            ends = [(row["low"], row["high"]) for row in rows]
            marks = [_severity_mark(name, metric, row) for row in rows]
            banded |= _curve(figure, panel, places, values, styles[name], marks, ends)
        # fixed positions keep the title and the labels out of the layout
        panel.set_title(name_text(long_label(corruption)), fontsize=8.5, y=1)
        panel.xaxis.set_label_coords(0.5, 0)
        panel.yaxis.set_label_coords(0, 0.5)
        panel.set_xticks(SEVERITIES)
        panel.set_xlim(0.7, 5.3)
        panel.tick_params(labelsize=7.5, left=False, bottom=False)  # grid lines mark the values already
    scale_panels(figure, LEAST_CRER if metric == "crer" else LEAST_PX)
    width, height = figure.get_size_inches()
    figure.supylabel(metric_label(metric), fontsize=9, x=0.08 / width, ha="left")
    figure.supxlabel("severity", fontsize=9, y=0.06 / height, va="bottom")
    key = [(name, styles[name], True) for name in runs]
    above = 0.3 + 0.17 * figure.explain(key, "upper center" if legend else "")
    figure.caption = f"{metric_label(metric)} by severity, with a panel per corruption and shared axes."
    figure.caption += _BANDS * banded
    figure.subplots_adjust(0.62 / width, 0.45 / height, 1 - 0.12 / width, 1 - above / height, 0.24, 0.34)
    return figure


@default_style()
def scale_panels(figure: MarkedFigure, least: float = LEAST_PX, *, apart: bool = False) -> None:
    """Set the limits of the vertical axes from the curves of all panels or, with `apart`, of each panel separately.
    Each axis starts at 0 unless a value is negative, and spans at least `least`."""

    def limits(panels: Sequence[Axes]) -> tuple[float, float]:
        values = [y for axes in panels for line in axes.lines for y in np.asarray(line.get_ydata(), float)]
        ends = [end for axes in panels for end in axes.dataLim.intervaly]
        return fair_limits(values, least, ends=ends, zero=True)

    together = None if apart else limits(figure.axes)
    for axes in figure.axes:
        axes.set_ylim(together or limits([axes]))


def _severity_mark(name: str, metric: str, row: FrameRow) -> Mark:
    interval = ends_text(None if row["low"] is None else (row["low"], row["high"]))
    where = (("corruption", long_label(row["condition"])), ("severity", str(row["severity"])))
    value = f"{row['value']:.2f} {UNITS[metric]}".strip() + interval
    return Mark(name, "", (*where, (LABELS[metric], value)))


@default_style()
def security_figure(points: Sequence[CurvePoint]) -> MarkedFigure:
    """Plot the security curves of a run; hollow markers indicate a warning."""
    if not points:
        raise UsageError("this run has no attacks and therefore no security curves; run it again with --attacks")
    styles = model_styles(point.attack for point in points)
    norms = [norm for norm in NORMS if any(point.norm == norm for point in points)]
    figure, axes = new_figure(4.4, 3.4, len(norms))
    label = metric_label(points[0].metric)
    banded = False
    for panel, norm in zip(axes, norms, strict=True):
        budgets = sorted({point.budget for point in points if point.norm == norm})
        for name in dict.fromkeys(point.attack for point in points if point.norm == norm):
            curve = [point for point in points if point.attack == name]
            places, errors = [budgets.index(point.budget) for point in curve], [point.error for point in curve]
            ends, hollow = [(point.low, point.high) for point in curve], [point.warned for point in curve]
            banded |= _curve(figure, panel, places, errors, styles[name], list(map(_budget_mark, curve)), ends, hollow)
        panel.set_xticks(range(len(budgets)), [f"{budget:g}" for budget in budgets])
        panel.set_title(NORMS[norm], fontsize=9)
        panel.set_xlabel("budget (%)" if norm == "area" else "budget (grey levels)", fontsize=8.5)
        panel.set_ylabel(label, fontsize=8.5)
    scale_panels(figure)
    figure.explain([(name_text(name), style, True) for name, style in styles.items()])
    figure.caption = (
        f"{label} by budget of each attack; budget 0: the clean frames; budgets are not to scale. Hollow markers "
        "indicate a warning."
    ) + _BANDS * banded
    return figure


def _budget_mark(point: CurvePoint) -> Mark:
    ends = None if point.low is None or point.high is None else (point.low, point.high)
    value = f"{point.error:.2f} px{ends_text(ends)}"
    where = (("norm", point.norm), ("budget", f"{point.budget:g}"))
    warning = "yes" if point.warned else "no"
    return Mark(point.attack, "", (*where, (LABELS[point.metric], value), ("warning", warning)))


@default_style()
def sparsification_curves(model: str, numbers: Numbers) -> MarkedFigure:
    """Plot the mean error of the remaining pixels when 0, 10, ... 90 % are removed: least confident first (solid), and
    largest errors first (dashed). All panels have the same axes.
    """
    left = [100 - removed for removed in _REMOVED]
    drawn: dict[tuple[str, int], tuple[list[float], list[float]]] = {}
    for family in FAMILY_LABELS:
        for level in (level for level in SEVERITIES if ("ause", family, level) in numbers):
            errors = [numbers[f"error_at_{share}", family, level]["value"] for share in left]
            oracle = [errors[0], *(numbers[f"oracle_at_{share}", family, level]["value"] for share in left[1:])]
            drawn[family, level] = errors, oracle
    families = list(dict.fromkeys(family for family, _ in drawn))
    if not families:
        raise UsageError("there is no sparsification curve: the run has no confidence or no ground truth")
    figure, axes = new_figure(2.6, 2.3, len(families), 4, above=0.3)
    styles = dict(zip(sorted({level for _, level in drawn}), MODEL_STYLES, strict=False))
    for (family, level), (errors, oracle) in drawn.items():
        panel, style = axes[families.index(family)], styles[level]
        panel.plot(_REMOVED, oracle, color=style.colour, linewidth=1.0, linestyle=(0, (3, 2)))
        where = (("class", FAMILY_LABELS[family]), ("severity", str(level)))
        marks = [
            Mark(model, "", (*where, ("removed", f"{r} %"), ("EPE", f"{e:.2f} px"), ("oracle", f"{o:.2f} px")))
            for r, e, o in zip(_REMOVED, errors, oracle, strict=True)
        ]
        _curve(figure, panel, _REMOVED, errors, style, marks)
    highest = [value for curves in drawn.values() for curve in curves for value in curve]
    for panel, family in zip(axes, families, strict=True):
        panel.set_title(FAMILY_LABELS[family], fontsize=9)
        panel.set_xlabel("removed (%)", fontsize=8)
        panel.tick_params(labelsize=7.5)
        panel.set_ylim(fair_limits(highest, LEAST_PX, zero=True))
    axes[0].set_ylabel("EPE of remaining pixels (px)", fontsize=8)
    figure.explain([(f"severity {level}", style, True) for level, style in styles.items()])
    figure.caption = (
        f"{model}: mean error of the remaining pixels after removing the least confident ones; dashed: after removing "
        "those with the largest errors. The area between the two is AUSE."
    )
    return figure


@default_style()
def displacement_figure(tables: Mapping[str, pl.DataFrame]) -> MarkedFigure:
    """Plot the share of pixels against their flow magnitude on a logarithmic axis, with a dashed line per table."""
    if len(tables) > MOST_LINES:
        raise UsageError(f"{len(tables)} histograms", f"one figure shows at most {MOST_LINES}")
    tables = {label: table for label, table in tables.items() if table["share"].sum() > 0}
    if not tables:
        raise UsageError("there are no displacements to draw: no pixel in these tables has a flow")
    figure, (axes,) = new_figure(6.4, 3.6)
    right = 0.0
    for drawn, (label, table) in enumerate(tables.items()):
        colour, dash = _DASHES[drawn]
        # wide lines first, so that a hidden line remains visible on both sides of the line above it
        width = 1.3 + 0.4 * (len(tables) - 1 - drawn)
        lows, highs, shares = table["low"].to_list(), table["high"].to_list(), [100 * s for s in table["share"]]
        step = lows[-1] - lows[-2] if len(lows) > 1 else 1.0
        edges = [*lows, highs[-1] if math.isfinite(highs[-1]) else lows[-1] + step]
        axes.stairs(shares, edges, color=colour, linestyle=dash, linewidth=width, baseline=None, label=name_text(label))
        filled = [index for index, share in enumerate(shares) if share > 0]
        centres = [(edges[index] + edges[index + 1]) / 2 for index in filled]
        dots = axes.plot(centres, [shares[index] for index in filled], "o", color=colour, markersize=2.5)
        figure.mark(dots[0], [_length_mark(label, lows[index], highs[index], shares[index]) for index in filled])
        right = max(right, edges[filled[-1] + 1])
    axes.set_yscale("log")
    axes.set_ylim(top=min(axes.get_ylim()[1], 130.0))
    axes.set_xlim(0, right)
    axes.set(xlabel="flow magnitude (px)", ylabel="pixels (%)")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    figure.caption = "Share of the pixels by flow magnitude on the clean frames, on a logarithmic axis."
    figure.legend(loc="outside upper center", ncols=1 if len(tables) > 2 else 2, frameon=False, fontsize=8)
    return figure


def _length_mark(label: str, low: float, high: float, share: float) -> Mark:
    where = f"{low:g} px and more" if math.isinf(high) else f"{low:g} to {high:g} px"
    return Mark(label, "", (("length", where), ("pixels", f"{share:.3g} %")))
