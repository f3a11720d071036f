"""The paper's figure of clean EPE, CRE and CREr: one bubble per model, whose area is CREr. Figure of effective
robustness: corrupted against clean EPE, with the trend over all models in a setting.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text, plain
from ...stats.effective import effective_robustness
from ...stats.model_result import ModelResult
from ...stats.published.tables import not_discussed, of_paper
from ...stats.results import AVERAGE, CLEAN, SETTING_LABELS
from ..paper_tables import settings_in_order
from .canvas import (
    LONGEST_NAME,
    WITH_INTERVALS,
    Mark,
    MarkedFigure,
    ends_text,
    fair_limits,
    new_figure,
    set_heading,
    settle_layout,
    spread_labels,
    whiskers,
)
from .styles import FigureStyles, kind_key

_AREA = 260.0
"""Area of a bubble with CREr 1, in square points, unless the largest bubble would exceed `_LARGEST`."""

_LARGEST = 1000.0


@default_style()
def clean_against_cre(
    results: Sequence[ModelResult], styling: FigureStyles | None = None, *, together: bool = False
) -> MarkedFigure:
    """Plot CRE (y) against clean EPE (x) with CREr as bubble area, in one panel per setting with the same axes."""
    styling = styling or FigureStyles()
    without, styles = not_discussed(results), styling.of(results)
    panels: dict[str, list[tuple[ModelResult, float, float]]] = {}
    for setting in settings_in_order(line.setting for line in results):
        for line in results:
            clean, cre = line.number("epe", CLEAN), line.cre.get(AVERAGE)
            if line.setting == setting and clean and cre is not None and line.name not in without:
                panels.setdefault("" if together else setting, []).append((line, clean, cre))
    if len(panels) > 1:
        panels.pop("knowledge", None)
    if not panels:
        raise UsageError("no model has both a clean and an average EPE: this figure needs runs with ground truth")
    figure, axes = new_figure(4.6, 4.2, len(panels))
    drawn = [one for models in panels.values() for one in models]
    scale = min(_AREA, _LARGEST / max(*(cre / clean for _, clean, cre in drawn), 1.0))
    reached: tuple[list[float], list[float]] = ([], [])
    any_interval = False
    names: list[tuple[list[tuple[float, float, str]], list[float]]] = []
    for panel, (title, models) in zip(axes, panels.items(), strict=True):
        points, radii = [], []
        for line, clean, cre in models:
            colour = styles[line].colour
            ends = line.intervals.get(("epe", CLEAN)), line.intervals.get(("cre", AVERAGE))
            any_interval |= whiskers(panel, clean, cre, *ends, colour)
            for axis, value, interval in zip(reached, (clean, cre), ends, strict=True):
                axis += (value, *(interval or ()))
            area = scale * max(cre / clean, 0.02)
            bubble = panel.scatter(clean, cre, s=area, color=colour, alpha=0.55, edgecolor="white", linewidth=0.8)
            values = (
                ("clean EPE", f"{clean:.2f} px{ends_text(ends[0])}"),
                ("CRE", f"{cre:.2f} px{ends_text(ends[1])}"),
                ("CREr", f"{cre / clean:.2f}"),
            )
            figure.mark(bubble, [Mark(line.name, line.setting, values)])
            panel.scatter(clean, cre, s=6, color=colour)
            radii.append(math.sqrt(area / math.pi))
            points.append((clean, cre, f"{plain(line.name, LONGEST_NAME)} {cre / clean:.2f}"))
        panel.set_title(name_text(SETTING_LABELS.get(title, title)))
        panel.tick_params(labelsize=8)
        panel.set_xlabel("clean EPE (px)")
        panel.set_ylabel("CRE (px)")
        names.append((points, radii))
    for panel in axes:
        panel.set_xlim(fair_limits(reached[0], room=0.15))
        panel.set_ylim(fair_limits(reached[1], room=0.15))
    figure.explain(kind_key(line.name for line, _, _ in drawn) if of_paper(results) else [], styling.legend)
    figure.caption = (
        "CRE against clean EPE; the area of a bubble is CREr, which is printed next to the name. A small bubble at "
        "the lower left is best." + (f" {WITH_INTERVALS}" if any_interval else "")
    )
    set_heading(figure, "Accuracy and robustness: area of a bubble = CREr, printed next to the name")
    settle_layout(figure)
    for panel, models, named in zip(axes, panels.values(), names, strict=True):
        for (line, _, _), text in zip(models, spread_labels(panel, *named), strict=True):
            figure.mark(text, [Mark(line.name, line.setting)])
    return figure


@default_style()
def effective_trend(
    results: Sequence[ModelResult], styling: FigureStyles | None = None, *, together: bool = False
) -> MarkedFigure:
    """Plot one panel per setting, all with the same axes. The factor printed for a model is its EPE divided by the EPE
    predicted from the trend of the other models.
    """
    styling = styling or FigureStyles()
    panels = effective_robustness(results, by_setting=not together)
    styles = styling.of(results)
    figure, axes = new_figure(4.6, 4.2, len(panels))
    any_interval = False
    reached: tuple[list[float], list[float]] = ([], [])
    for panel, (title, models) in zip(axes, panels.items(), strict=True):
        clean, corrupted = (np.array([getattr(one, what) for one in models]) for what in ("clean", "corrupted"))
        panel.set_xscale("log")
        panel.set_yscale("log")
        for one in models:
            style, at = styles[one.line], (one.clean, one.corrupted)
            ends = one.line.intervals.get(("epe", CLEAN)), one.line.intervals.get(("epe", AVERAGE))
            any_interval |= whiskers(panel, *at, *ends, style.colour)
            for along, value, interval in zip(reached, at, ends, strict=True):
                along += (value, *(end for end in interval or () if end > 0))
            point = panel.scatter(*at, s=30, color=style.colour, marker=style.marker)
            values = (
                ("clean EPE", f"{at[0]:.2f} px{ends_text(ends[0])}"),
                ("corrupted EPE", f"{at[1]:.2f} px{ends_text(ends[1])}"),
                ("expected", f"{one.expected:.2f} px"),
                ("factor", f"{one.factor:.2f}"),
            )
            figure.mark(point, [Mark(one.line.name, one.line.setting, values)])
        line = np.polyfit(np.log(clean), np.log(corrupted), 1)
        span = np.array([clean.min() * 0.9, clean.max() * 1.1])
        panel.plot(span, np.exp(np.polyval(line, np.log(span))), color="black", linewidth=1)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter() if len(models) > 20 else ScalarFormatter())
            axis.set_tick_params(which="both", labelsize=7)
        panel.set_xlabel("clean EPE (px)")
        panel.set_ylabel("corrupted EPE (px)")
        panel.set_title(
            f"{name_text(SETTING_LABELS.get(title, title))}: R² = {models[0].r_squared:.2f}".removeprefix(": "),
            fontsize=10,
        )
    for panel in axes:
        panel.set_xlim(_log_limits(reached[0]))
        panel.set_ylim(_log_limits(reached[1]))
    names = [one.line.name for models in panels.values() for one in models]
    figure.explain(kind_key(names) if of_paper(results) else [], styling.legend)
    figure.caption = (
        "Corrupted against clean EPE on logarithmic axes, with the trend through the models. Models below the line "
        "are more robust than their clean error predicts. The printed factor is the EPE divided by the EPE predicted "
        "from the trend of the other models."
    ) + (f" {WITH_INTERVALS}" if any_interval else "")
    set_heading(figure, "Effective robustness: models below the line are more robust than their clean error predicts")
    settle_layout(figure)
    for panel, models in zip(axes, panels.values(), strict=True):
        labels = [
            (one.clean, one.corrupted, f"{plain(one.line.name, LONGEST_NAME)} ×{one.factor:.2f}") for one in models
        ]
        for one, text in zip(models, spread_labels(panel, labels), strict=True):
            figure.mark(text, [Mark(one.line.name, one.line.setting)])
    return figure


def _log_limits(values: list[float]) -> tuple[float, float]:
    """Choose limits of a logarithmic axis that differ by a factor of at least 2."""
    low, high = min(values), max(values)
    wider = max(1.12, (2 * low / high) ** 0.5)
    return low / wider, high * wider
