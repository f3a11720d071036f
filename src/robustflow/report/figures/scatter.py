"""Figures with one point per model: the paper's bubbles of clean EPE, CRE and CREr, its relations between the metrics,
and effective robustness with the trend over all models in a setting.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text, plain
from ...stats.effective import effective_robustness
from ...stats.intervals import IntervalEnds
from ...stats.lines import CRER, LineKey, Lines, Numbers, number_of
from ...stats.published.tables import not_discussed, of_paper
from ...stats.ranking import LEAST_MODELS, spearman
from ...stats.results import AVERAGE, CLEAN, SETTING_LABELS
from ..table import cell_of
from .canvas import (
    LONGEST_NAME,
    WITH_INTERVALS,
    Mark,
    MarkedFigure,
    ends_text,
    fair_limits,
    new_figure,
    settle_layout,
    spread_labels,
)
from .styles import OTHER, PLAIN_STYLES, FigureStyles, by_setting, kind_key, model_key

_AREA = 260.0
"""Area of a bubble with CREr 1, in square points, unless the largest bubble would exceed `_LARGEST`."""
_LARGEST = 1000.0
_QUANTITIES = {
    "clean EPE": ("epe", CLEAN),
    "corrupted EPE": ("epe", AVERAGE),
    "CRE": ("cre", AVERAGE),
    "RCRE": ("rcre", AVERAGE),
}
_RELATIONS = (("clean EPE", "corrupted EPE"), ("clean EPE", "CRE"), ("clean EPE", "RCRE"), ("CRE", "RCRE"))


@dataclass
class _Point:
    """A model in a panel: its place, the intervals of both coordinates, the printed values, and the name beside it."""

    line: LineKey
    at: tuple[float, float]
    ends: tuple[IntervalEnds | None, IntervalEnds | None]
    values: tuple[tuple[str, str], ...]
    name: str
    area: float = 30.0


def _draw(
    figure: MarkedFigure, panel: Axes, points: Sequence[_Point], colours: Mapping[LineKey, str], **look: Any
) -> None:
    for point in points:
        (x, y), (across, up) = point.at, point.ends
        whisker: Any = {"color": colours[point.line], "linewidth": 0.9, "alpha": 0.7, "zorder": 1.5}
        if across is not None:
            panel.plot(across, (y, y), solid_capstyle="butt", **whisker)
        if up is not None:
            panel.plot((x, x), up, solid_capstyle="butt", **whisker)
        dot = panel.scatter(*point.at, s=point.area, color=colours[point.line], **look)
        figure.mark(dot, [Mark(point.line.model, point.line.setting, point.values)])


def _finish(
    figure: MarkedFigure,
    panels: Sequence[tuple[Axes, Sequence[_Point]]],
    styling: FigureStyles,
    caption: str,
    heading: str,
) -> MarkedFigure:
    """Add the key, the caption and the heading, and place the names, which needs the final layout."""
    every = [point for _, points in panels for point in points]
    lines = [point.line for point in every]
    figure.explain(kind_key(line.model for line in lines) if of_paper(lines) else [], styling.legend)
    figure.caption = caption + (f" {WITH_INTERVALS}" if any(any(point.ends) for point in every) else "")
    figure.suptitle(textwrap.fill(heading, int(12.5 * figure.get_figwidth())), fontsize=10)
    settle_layout(figure)
    for panel, points in panels:
        radii = [math.sqrt(point.area / math.pi) for point in points]
        texts = spread_labels(panel, [(*point.at, point.name) for point in points], radii)
        for point, text in zip(points, texts, strict=True):
            figure.mark(text, [Mark(point.line.model, point.line.setting)])
    return figure


def _cre_text(numbers: Numbers, cre: float) -> str:
    """Return the CRE with its interval, and the published one if it differs."""
    given = numbers.get(("cre", AVERAGE, None))
    text = f"{cre:.2f} px{ends_text(numbers.ends('cre', AVERAGE))}"
    if given is None or number_of(given) == f"{cre:.2f}":
        return text
    return f"{text} from the EPE, {number_of(given)} px as published"


@default_style()
def clean_against_cre(results: Lines, styling: FigureStyles = PLAIN_STYLES) -> MarkedFigure:
    """Plot CRE (y) against clean EPE (x) with CREr as bubble area, in panels with the same axes."""
    together, without, published = not by_setting(results), not_discussed(results), of_paper(results)
    groups: dict[str, list[_Point]] = {}
    for setting in _settings_in_order(line.setting for line in results):
        for line, numbers in results.items():
            clean, cre, crer = numbers.number("epe", CLEAN), numbers.changes().get(AVERAGE), numbers.get(CRER)
            if line.setting != setting or clean is None or cre is None or line.model in without:
                continue
            ratio = "" if crer is None else cell_of(crer).marked.text
            ends = numbers.ends("epe", CLEAN), numbers.ends("cre", AVERAGE)
            texts = [f"{clean:.2f} px{ends_text(ends[0])}", _cre_text(numbers, cre), ratio or "none"]
            values = tuple(zip(("clean EPE", "CRE", "CREr"), texts, strict=True))
            name = f"{plain(line.model, LONGEST_NAME)} {ratio}".rstrip()
            point = _Point(line, (clean, cre), ends, values, name, 0.0 if crer is None else crer["value"])
            groups.setdefault("" if together else setting, []).append(point)
    if len(groups) > 1:
        groups.pop("knowledge", None)
    if not groups:
        raise UsageError("no model has both a clean and an average EPE: this figure needs runs with ground truth")
    points = [point for group in groups.values() for point in group]
    scale = min(_AREA, _LARGEST / max(*(point.area for point in points), 1.0))
    for point in points:
        point.area = scale * max(point.area, 0.02)
    figure, axes = new_figure(4.6, 4.2, len(groups))
    colours = {line: style.colour for line, style in styling.of(results).items()}
    limits = [
        fair_limits((one.at[axis] for one in points), ends=_ends(one.ends[axis] for one in points), room=0.15)
        for axis in (0, 1)
    ]
    for panel, (title, group) in zip(axes, groups.items(), strict=True):
        _draw(figure, panel, group, colours, alpha=0.55, edgecolor="white", linewidth=0.8)
        for point in group:
            panel.scatter(*point.at, s=6, color=colours[point.line])
        panel.set_title(name_text(SETTING_LABELS.get(title, title)))
        panel.tick_params(labelsize=8)
        panel.set(xlim=limits[0], ylim=limits[1], xlabel="clean EPE (px)", ylabel="CRE (px)")
    caption = "CRE against clean EPE; the area of a bubble is CREr, printed beside the name. Lower left is best."
    caption += " Published CRE is from the EPE; CREr is as published, †: from the EPE." * published
    heading = "Accuracy and robustness: area of a bubble = CREr, printed next to the name"
    return _finish(figure, list(zip(axes, groups.values(), strict=True)), styling, caption, heading)


@default_style()
def effective_trend(results: Lines, styling: FigureStyles = PLAIN_STYLES) -> MarkedFigure:
    """Plot panels with the same axes. The factor printed for a model is its EPE divided by the EPE predicted from the
    trend of the other models.
    """
    settings = effective_robustness(results, by_setting=by_setting(results))
    styles = styling.of(results)
    figure, axes = new_figure(4.6, 4.2, len(settings))
    panels = []
    for panel, (title, models) in zip(axes, settings.items(), strict=True):
        points = []
        for line, one in models.items():
            ends = results[line].ends("epe", CLEAN), results[line].ends("epe", AVERAGE)
            values = (
                ("clean EPE", f"{one.clean:.2f} px{ends_text(ends[0])}"),
                ("corrupted EPE", f"{one.corrupted:.2f} px{ends_text(ends[1])}"),
                ("expected", f"{one.expected:.2f} px"),
                ("factor", f"{one.factor:.2f}"),
            )
            name = f"{plain(line.model, LONGEST_NAME)} ×{one.factor:.2f}"
            points.append(_Point(line, (one.clean, one.corrupted), ends, values, name))
        panel.set(xscale="log", yscale="log", xlabel="clean EPE (px)", ylabel="corrupted EPE (px)")
        for point in points:
            style = styles[point.line]
            _draw(figure, panel, [point], {point.line: style.colour}, marker=style.marker)
        clean, corrupted = np.array([point.at for point in points]).T
        trend = np.polyfit(np.log(clean), np.log(corrupted), 1)
        span = np.array([clean.min() * 0.9, clean.max() * 1.1])
        panel.plot(span, np.exp(np.polyval(trend, np.log(span))), color="black", linewidth=1)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter() if len(models) > 20 else ScalarFormatter())
            axis.set_tick_params(which="both", labelsize=7)
        setting = name_text(SETTING_LABELS.get(title, title))
        r_squared = np.corrcoef(np.log(clean), np.log(corrupted))[0, 1] ** 2
        panel.set_title(f"{setting}: R² = {r_squared:.2f}".removeprefix(": "), fontsize=10)
        panels.append((panel, points))
    every = [point for _, points in panels for point in points]
    for panel in axes:
        panel.set(xlim=_log_limits(every, 0), ylim=_log_limits(every, 1))
    caption = (
        "Corrupted against clean EPE on logarithmic axes, with the trend through the models. The printed factor is the "
        "EPE divided by the EPE expected from the trend of the other models; below 1, and below the line, a model is "
        "more robust than its clean error predicts."
    )
    heading = "Effective robustness: models below the line are more robust than their clean error predicts"
    return _finish(figure, panels, styling, caption, heading)


def _log_limits(points: Sequence[_Point], axis: int) -> tuple[float, float]:
    """Choose limits of a logarithmic axis that differ by a factor of at least 2; intervals widen it on each side by at
    most a factor of 3."""
    values = [point.at[axis] for point in points]
    inside = np.clip(_ends(point.ends[axis] for point in points), min(values) / 3, max(values) * 3)
    low, high = min(*values, *inside), max(*values, *inside)
    wider = max(1.12, (2 * low / high) ** 0.5)
    return low / wider, high * wider


def _ends(intervals: Iterable[IntervalEnds | None]) -> list[float]:
    """Return the ends of all known intervals."""
    return [end for ends in intervals for end in ends or ()]


@default_style()
def relations(results: Lines, styling: FigureStyles = PLAIN_STYLES) -> MarkedFigure:
    """Plot four panels with one point per model: corrupted EPE, CRE and RCRE against clean EPE, and RCRE against CRE,
    each with its correlations. A quantity has the same axis range in every panel.
    """
    together, without, styles = not by_setting(results), not_discussed(results), styling.of(results)
    groups: dict[str, dict[LineKey, dict[str, float]]] = {}
    for line, numbers in results.items():
        values = {name: numbers.number(*key) for name, key in _QUANTITIES.items()}
        values["CRE"] = numbers.changes().get(AVERAGE)
        known = {name: value for name, value in values.items() if value is not None}
        if len(known) == len(_QUANTITIES) and line.model not in without:
            groups.setdefault(line.setting, {})[line] = known
    if len(groups) > 1 and not together:
        groups.pop("knowledge", None)
    drawn = {line: values for models in groups.values() for line, values in models.items()}
    if len(drawn) < LEAST_MODELS:
        raise UsageError(
            "relations",
            f"the figure of EPE, CRE and RCRE needs at least {LEAST_MODELS} models with ground truth, not {len(drawn)}",
        )
    figure, axes = new_figure(3.3, 3.2, 4, columns=2)
    ends = {(line, name): results[line].ends(*key) for line in drawn for name, key in _QUANTITIES.items()}
    limits = {
        name: fair_limits((of[name] for of in drawn.values()), ends=_ends(ends[line, name] for line in drawn))
        for name in _QUANTITIES
    }
    for letter, panel, (x, y) in zip("abcd", axes, _RELATIONS, strict=True):
        for line, at in drawn.items():
            style = styles[line]
            printed = tuple(
                (
                    name,
                    _cre_text(results[line], value)
                    if name == "CRE"
                    else f"{value:.2f} px{ends_text(ends[line, name])}",
                )
                for name, value in at.items()
            )
            point = _Point(line, (at[x], at[y]), (ends[line, x], ends[line, y]), printed, "", 26.0)
            face = "white" if line.setting == "ID" and not together else style.colour
            look = {"marker": style.marker, "facecolor": face, "edgecolor": style.colour, "linewidth": 1.1}
            _draw(figure, panel, [point], {line: style.colour}, **look)
        panel.set(xlim=limits[x], ylim=limits[y])
        panel.set_xlabel(f"{x} (px)", fontsize=9)
        panel.set_ylabel(f"{y} (px)", fontsize=9)
        panel.tick_params(labelsize=8)
        parts = {"": drawn} if together else {f"{name_text(setting)}: ": of for setting, of in groups.items()}
        correlations = [
            f"{head}{_correlation(list(of.values()), x, y)}" for head, of in parts.items() if len(of) >= LEAST_MODELS
        ]
        panel.set_title(f"({letter}) " + "\n".join(correlations), fontsize=8, loc="left")
    if of_paper(results):
        key = kind_key(line.model for line in drawn) + [(setting, OTHER, setting != "ID") for setting in groups]
    else:
        key = model_key({line.model: styles[line] for line in drawn})
    figure.explain(key, styling.legend)
    figure.caption = "One point per model, with Pearson's r and Spearman's rho." + (
        f" {WITH_INTERVALS}" if any(ends.values()) else ""
    )
    return figure


def _correlation(points: list[dict[str, float]], x: str, y: str) -> str:
    xs, ys = (np.array([point[name] for point in points]) for name in (x, y))
    if np.ptp(xs) == 0 or np.ptp(ys) == 0:
        return "no correlation: one variable is constant"
    return f"r = {np.corrcoef(xs, ys)[0, 1]:.2f}, rho = {spearman(xs, ys):.2f}, {len(xs)} models"


def _settings_in_order(settings: Iterable[str]) -> list[str]:
    """Return the distinct settings, with the paper's settings first."""
    known = set(settings)
    return [name for name in SETTING_LABELS if name in known] + sorted(known - set(SETTING_LABELS))
