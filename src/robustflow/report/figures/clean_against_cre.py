"""The paper's figure of clean EPE, CRE and CREr: one bubble per model, its area CREr."""

from __future__ import annotations

import math

import polars as pl

from ...analysis.labels import SETTING_LABELS
from ...analysis.published.tables import PAPER, not_discussed
from ...analysis.results import AVERAGE, CLEAN, values_of
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text
from ..tables import settings_in_order
from .canvas import WITH_INTERVALS, ends_text, fair_limits, panel_figure, set_heading, spread_labels, whiskers
from .files import settle_layout
from .marks import Mark, MarkedFigure
from .styles import KIND_STYLES, Looks, kind_of

Model = tuple[str, str]
"""(setting, name)."""

_AREA = 260.0
"""Square points of a bubble of CREr 1, if none is larger than `_LARGEST`."""

_LARGEST = 1000.0


@default_style()
def clean_against_cre(results: pl.DataFrame, looks: Looks | None = None, *, together: bool = False) -> MarkedFigure:
    """Clean EPE (x) against CRE (y) with CREr as the bubble's area, one panel per setting, all on the same axes.

    CRE is computed from the EPE. Of the paper's models those of `not_discussed` are left out, and knowledge-driven
    methods if there are others, as in the paper.

    Args:
        results: with clean and average EPE.
        looks: styles and intervals of the models.
        together: all models in one panel, including knowledge-driven ones.

    Raises:
        UsageError: no model has a clean and an average EPE.
    """
    looks = looks or Looks()
    epe, without, styles = values_of(results, "epe"), not_discussed(results), looks.of(results)
    panels: dict[str, list[Model]] = {}
    for setting in settings_in_order(results["setting"]):
        models = [(s, model) for s, model, name in epe if s == setting and name == AVERAGE and model not in without]
        models = [key for key in models if epe.get((*key, CLEAN))]
        if models:
            panels.setdefault("" if together else setting, []).extend(models)
    if len(panels) > 1:
        panels.pop("knowledge", None)
    if not panels:
        raise UsageError("no clean EPE and average EPE to draw: this figure needs runs with ground truth")
    figure, axes = panel_figure(len(panels))
    drawn = [key for models in panels.values() for key in models]
    scale = min(_AREA, _LARGEST / max(*(epe[*key, AVERAGE] / epe[*key, CLEAN] - 1 for key in drawn), 1.0))
    reached: tuple[list[float], list[float]] = ([], [])
    any_interval = False
    names: list[tuple[list[tuple[float, float, str]], list[float]]] = []
    for panel, (title, models) in zip(axes, panels.items(), strict=True):
        points, radii = [], []
        for setting, model in models:
            clean = epe[setting, model, CLEAN]
            cre = epe[setting, model, AVERAGE] - clean
            colour = styles[model].colour
            ends = looks.ends(model, "epe", CLEAN), looks.ends(model, "cre", AVERAGE)
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
            figure.mark(bubble, [Mark(model, setting, values)])
            panel.scatter(clean, cre, s=6, color=colour)
            radii.append(math.sqrt(area / math.pi))
            points.append((clean, cre, f"{model} {cre / clean:.2f}"))
        panel.set_title(name_text(SETTING_LABELS.get(title, title)))
        panel.set_xlabel("clean EPE (px)")
        panel.set_ylabel("CRE (px)")
        names.append((points, radii))
    for panel in axes:
        panel.set_xlim(fair_limits(reached[0], room=0.15))
        panel.set_ylim(fair_limits(reached[1], room=0.15))
    shown = {kind_of(model) for _, model in drawn} if PAPER in results["sample_set"] else set()
    figure.explain([(kind, style, True) for kind, style in KIND_STYLES.items() if kind in shown], looks.legend)
    figure.caption = (
        "Clean EPE to the right, CRE upwards; the area of a bubble is CREr, which is printed next to the name. "
        "Best is a small bubble at the lower left." + (f" {WITH_INTERVALS}" if any_interval else "")
    )
    set_heading(figure, "Accuracy and robustness: area of a bubble = CREr, printed next to the name")
    settle_layout(figure)
    for panel, models, named in zip(axes, panels.values(), names, strict=True):
        for (setting, model), text in zip(models, spread_labels(panel, *named), strict=True):
            figure.mark(text, [Mark(model, setting)])
    return figure
