"""The paper's figure of clean EPE, CRE and CREr: one bubble per model, its area CREr."""

from __future__ import annotations

import math

import polars as pl
from matplotlib.lines import Line2D

from ...analysis.labels import SETTING_LABELS
from ...analysis.published.tables import not_discussed
from ...analysis.results import AVERAGE, CLEAN, values_of
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text
from ..tables import settings_in_order
from .canvas import KIND_COLOURS, kind_of, panel_figure, set_heading, spread_labels
from .files import settle_layout
from .marks import Mark, MarkedFigure

Model = tuple[str, str]
"""(setting, name)."""

_AREA = 260.0
"""Square points of a bubble of CREr 1, if none is larger than `_LARGEST`."""

_LARGEST = 1000.0


@default_style()
def clean_against_cre(results: pl.DataFrame, *, together: bool = False) -> MarkedFigure:
    """Clean EPE (x) against CRE (y) with CREr as the bubble's area, one panel per setting.

    CRE is computed from the EPE. Of the paper's models those of `not_discussed` are left out, and knowledge-driven
    methods if there are others, as in the paper.

    Args:
        results: with clean and average EPE.
        together: all models in one panel, including knowledge-driven ones.

    Raises:
        UsageError: no model has a clean and an average EPE.
    """
    epe, without = values_of(results, "epe"), not_discussed(results)
    panels: dict[str, list[Model]] = {}
    for setting in settings_in_order(results):
        models = [(s, model) for s, model, name in epe if s == setting and name == AVERAGE and model not in without]
        models = [key for key in models if epe.get((*key, CLEAN))]
        if models:
            panels.setdefault("" if together else setting, []).extend(models)
    if len(panels) > 1:
        panels.pop("knowledge", None)
    if not panels:
        raise UsageError("no clean EPE and average EPE to draw: this figure needs runs with ground truth")
    figure, axes = panel_figure(len(panels))
    ratios = [epe[*key, AVERAGE] / epe[*key, CLEAN] - 1 for models in panels.values() for key in models]
    scale = min(_AREA, _LARGEST / max(*ratios, 1.0))
    kinds: dict[str, None] = {}
    names: list[tuple[list[tuple[float, float, str]], list[float]]] = []
    for panel, (title, models) in zip(axes, panels.items(), strict=True):
        points, radii = [], []
        for setting, model in models:
            clean = epe[setting, model, CLEAN]
            cre = epe[setting, model, AVERAGE] - clean
            kind = kind_of(model)
            kinds[kind] = None
            area = scale * max(cre / clean, 0.02)
            bubble = panel.scatter(
                clean, cre, s=area, color=KIND_COLOURS[kind], alpha=0.55, edgecolor="white", linewidth=0.8
            )
            values = (("clean EPE", f"{clean:.2f} px"), ("CRE", f"{cre:.2f} px"), ("CREr", f"{cre / clean:.2f}"))
            figure.mark(bubble, [Mark(model, setting, values)])
            panel.scatter(clean, cre, s=6, color=KIND_COLOURS[kind])
            radii.append(math.sqrt(area / math.pi))
            points.append((clean, cre, f"{model} {cre / clean:.2f}"))
        panel.margins(0.22, 0.18)
        panel.set_title(name_text(SETTING_LABELS.get(title, title)))
        panel.set_xlabel("clean EPE (px)")
        panel.set_ylabel("CRE (px)")
        names.append((points, radii))
    handles = [
        Line2D([], [], marker="o", linestyle="", color=KIND_COLOURS[kind], label=kind)
        for kind in KIND_COLOURS
        if kind in kinds
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8)
    set_heading(figure, "Accuracy and robustness: area of a bubble = CREr, printed next to the name")
    settle_layout(figure)
    for panel, models, named in zip(axes, panels.values(), names, strict=True):
        for (setting, model), text in zip(models, spread_labels(panel, *named), strict=True):
            figure.mark(text, [Mark(model, setting)])
    return figure
