"""The paper's figure of how clean EPE, corrupted EPE, CRE and RCRE are related, with correlations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text
from ...stats.model_result import ModelResult
from ...stats.published.tables import not_discussed, of_paper
from ...stats.ranking import LEAST_MODELS, spearman
from ...stats.results import AVERAGE, CLEAN
from .canvas import WITH_INTERVALS, Mark, MarkedFigure, ends_text, fair_limits, new_figure, whiskers
from .styles import OTHER, FigureStyles, kind_key, model_key

_PANELS = (("clean EPE", "corrupted EPE"), ("clean EPE", "CRE"), ("clean EPE", "RCRE"), ("CRE", "RCRE"))
_OF = {
    "clean EPE": ("epe", CLEAN),
    "corrupted EPE": ("epe", AVERAGE),
    "CRE": ("cre", AVERAGE),
    "RCRE": ("rcre", AVERAGE),
}


@default_style()
def relations(
    results: Sequence[ModelResult], styling: FigureStyles | None = None, *, together: bool = False
) -> MarkedFigure:
    """Plot four panels with one point per model: corrupted EPE, CRE and RCRE against clean EPE, and RCRE against CRE. A
    quantity has the same axis range in every panel.
    """
    styling = styling or FigureStyles()
    without, styles = not_discussed(results), styling.of(results)
    points: dict[str, dict[ModelResult, dict[str, float]]] = {}
    for line in results:
        values = {name: line.cre.get(AVERAGE) if name == "CRE" else line.number(*key) for name, key in _OF.items()}
        known = {name: value for name, value in values.items() if value is not None}
        if len(known) == len(_OF) and line.name not in without:
            points.setdefault(line.setting, {})[line] = known
    if len(points) > 1 and not together:
        points.pop("knowledge", None)
    drawn = {line: values for models in points.values() for line, values in models.items()}
    if len(drawn) < LEAST_MODELS:
        raise UsageError(
            f"the figure of EPE, CRE and RCRE needs at least {LEAST_MODELS} models with ground truth, "
            f"found {len(drawn)}"
        )
    figure, axes = new_figure(3.3, 3.2, 4, columns=2)
    ends = {(line, name): line.intervals.get(key) for line in drawn for name, key in _OF.items()}
    limits = {
        name: fair_limits([value for line in drawn for value in (drawn[line][name], *(ends[line, name] or ()))])
        for name in _OF
    }
    for letter, panel, (x, y) in zip("abcd", axes, _PANELS, strict=True):
        for line, at in drawn.items():
            style = styles[line]
            whiskers(panel, at[x], at[y], ends[line, x], ends[line, y], style.colour)
            face = "white" if line.setting == "ID" and not together else style.colour
            dot = panel.scatter(
                at[x], at[y], s=26, marker=style.marker, facecolor=face, edgecolor=style.colour, linewidth=1.1
            )
            printed = tuple((name, f"{value:.2f} px{ends_text(ends[line, name])}") for name, value in at.items())
            figure.mark(dot, [Mark(line.name, line.setting, printed)])
        panel.set_xlim(limits[x])
        panel.set_ylim(limits[y])
        panel.set_xlabel(f"{x} (px)", fontsize=9)
        panel.set_ylabel(f"{y} (px)", fontsize=9)
        panel.tick_params(labelsize=8)
        groups = {f"{name_text(setting)}: ": list(of.values()) for setting, of in points.items()}
        if together:
            groups = {"": list(drawn.values())}
        enough = {head: group for head, group in groups.items() if len(group) >= LEAST_MODELS}
        correlations = [f"{head}{_correlation(group, x, y)}" for head, group in enough.items()]
        panel.set_title(f"({letter}) " + "\n".join(correlations), fontsize=8, loc="left")
    if of_paper(results):
        key = kind_key(line.name for line in drawn) + [(setting, OTHER, setting != "ID") for setting in points]
    else:
        key = model_key({line.name: styles[line] for line in drawn})
    figure.explain(key, styling.legend)
    figure.caption = (
        "Corrupted EPE, CRE and RCRE against clean EPE, and RCRE against CRE, with one point per model, Pearson's r "
        "and Spearman's rho."
    ) + (f" {WITH_INTERVALS}" if any(ends.values()) else "")
    return figure


def _correlation(points: list[dict[str, float]], x: str, y: str) -> str:
    xs, ys = (np.array([point[name] for point in points]) for name in (x, y))
    if np.ptp(xs) == 0 or np.ptp(ys) == 0:
        return "no correlation: one variable is constant"
    return f"r = {np.corrcoef(xs, ys)[0, 1]:.2f}, rho = {spearman(xs, ys):.2f}, {len(xs)} models"
