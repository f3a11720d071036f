"""The paper's figure of how clean EPE, corrupted EPE, CRE and RCRE are related, with correlations."""

from __future__ import annotations

import numpy as np
import polars as pl
from matplotlib.lines import Line2D

from ...analysis.published.tables import not_discussed
from ...analysis.rank_correlation import spearman
from ...analysis.results import AVERAGE, CLEAN, values_of
from ...errors import UsageError
from ...figure_style import default_style
from ...text import counted, name_text
from .canvas import ORANGE, SETTING_COLOURS, new_figure
from .marks import Mark, MarkedFigure

_PANELS = (("clean EPE", "corrupted EPE"), ("clean EPE", "CRE"), ("clean EPE", "RCRE"), ("CRE", "RCRE"))


@default_style()
def relations(results: pl.DataFrame, *, together: bool = False) -> MarkedFigure:
    """Four panels: corrupted EPE, CRE and RCRE against clean EPE, and RCRE against CRE, a point per model.

    Pearson's r and Spearman's rho are given per setting. `not_discussed` are left out, and knowledge-driven methods if
    there are others, as in the paper's discussion; CRE is computed from the EPE. With `together` all models are drawn,
    and one correlation is given over all of them.

    Raises:
        UsageError: no model has all four.
    """
    epe, rcre = values_of(results, "epe"), values_of(results, "rcre")
    without = not_discussed(results)
    models = [(s, m) for s, m, name in epe if name == AVERAGE and m not in without]
    points: dict[str, list[dict[str, float]]] = {}
    marks: dict[str, list[Mark]] = {}
    for setting, model in models:
        clean, moved = epe.get((setting, model, CLEAN)), rcre.get((setting, model, AVERAGE))
        if clean is not None and moved is not None:
            whole = epe[setting, model, AVERAGE]
            point = {"clean EPE": clean, "corrupted EPE": whole, "CRE": whole - clean, "RCRE": moved}
            points.setdefault(setting, []).append(point)
            values = tuple((label, f"{value:.2f} px") for label, value in point.items())
            marks.setdefault(setting, []).append(Mark(model, setting, values))
    if len(points) > 1 and not together:
        points.pop("knowledge", None)
    if not points:
        raise UsageError("no model has clean EPE, corrupted EPE and RCRE: this figure needs runs with ground truth")
    figure, axes = new_figure(8.4, 7.2, 2, 2)
    for letter, panel, (x, y) in zip("abcd", axes, _PANELS, strict=True):
        headings = []
        for setting, entries in points.items():
            xs, ys = (np.array([point[name] for point in entries]) for name in (x, y))
            drawn = panel.scatter(
                xs, ys, s=26, color=SETTING_COLOURS.get(setting, ORANGE), alpha=0.8, edgecolor="white", linewidth=0.5
            )
            figure.mark(drawn, marks[setting])
            headings.append(f"{name_text(setting)}: {_correlation(xs, ys)}")
        if together:
            every = [point for values in points.values() for point in values]
            headings = [_correlation(*(np.array([point[name] for point in every]) for name in (x, y)))]
        panel.set_xlabel(f"{x} (px)")
        panel.set_ylabel(f"{y} (px)")
        panel.set_title(f"({letter}) " + "\n".join(headings), fontsize=8, loc="left")
    handles = [
        Line2D(
            [],
            [],
            marker="o",
            linestyle="",
            color=SETTING_COLOURS.get(s, ORANGE),
            label=f"{name_text(s)} ({counted(len(models), 'model')})",
        )
        for s, models in points.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8)
    return figure


def _correlation(xs: np.ndarray, ys: np.ndarray) -> str:
    if len(xs) < 3 or np.ptp(xs) == 0 or np.ptp(ys) == 0:
        return "too few models for a correlation"
    return f"r = {np.corrcoef(xs, ys)[0, 1]:.2f}, rho = {spearman(xs, ys):.2f}"
