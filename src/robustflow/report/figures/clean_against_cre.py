"""The paper's figure of clean EPE, CRE and CREr: one bubble per model, whose area is CREr."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...analysis.labels import SETTING_LABELS
from ...analysis.model_result import ModelResult
from ...analysis.published.tables import not_discussed, of_paper
from ...analysis.results import AVERAGE, CLEAN
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text, plain
from ..tables import settings_in_order
from .canvas import (
    LONGEST_NAME,
    WITH_INTERVALS,
    ends_text,
    fair_limits,
    new_figure,
    set_heading,
    spread_labels,
    whiskers,
)
from .files import settle_layout
from .marks import Mark, MarkedFigure
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
