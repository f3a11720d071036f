"""The paper's figure of CREr by corruption class, out-of-domain and in-domain, and the same figure for other models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from ...core.display import default_style
from ...core.errors import UsageError
from ...core.text import name_text
from ...corruptions.registry import MEMBERS
from ...stats.lines import LineKey, Lines, Numbers
from ...stats.published.tables import of_paper
from ...stats.results import FAMILY_LABELS
from ..leaderboard import by_error
from .canvas import WITH_INTERVALS, Mark, MarkedFigure, ends_text, fair_limits, new_figure
from .styles import MODEL_STYLES, OTHER, PLAIN_STYLES, FigureStyles, Style, distinct_styles

REPRESENTATIVE = ("SAMFlow-H", "CSFlow", "ARFlow")
LEAST_CRER = 0.5
"""Minimum upper limit of the CREr axis."""


@default_style()
def crer_by_family(results: Lines, styling: FigureStyles = PLAIN_STYLES) -> MarkedFigure:
    """Draw bars of CREr per family, on one axis."""
    crer = {key: numbers for key, numbers in results.items() if numbers.family_crer()}
    published = of_paper(results)
    models = REPRESENTATIVE if published else tuple(line.model for line in crer)
    in_order = dict.fromkeys(line.model for line, _ in sorted(crer.items(), key=by_error))
    lowest = [name for name in in_order if name in models]
    shown = [name for name in dict.fromkeys(models) if name in lowest[: len(MODEL_STYLES)]]
    if not shown:
        raise UsageError("there is no CREr to draw: none of these models has a clean EPE")
    lines = [line for model in shown for line in crer if line.model == model]
    families = [family for family in MEMBERS if any(("crer", family, None) in crer[line] for line in lines)]
    if len(lines) * len(families) < 2:
        raise UsageError(
            "one corruption class and one model give only one bar: add corruptions or models, or use the table"
        )
    if published:
        styles = styling.of(results)
    else:
        by_name = distinct_styles({line.model: styling.styles.get(line) for line in lines})
        styles = {line: by_name[line.model] for line in lines}
    by_setting = published or len(lines) > len(shown)
    heights: list[float] = []
    if published:
        figure, axes = new_figure(3.9, 3.0, len(shown), above=0.4)
        for panel, model in zip(axes, shown, strict=True):
            drawn = [line for line in lines if line.model == model]
            heights += _bars(figure, panel, drawn, families, crer, styles, by_setting)
            panel.set_title(name_text(model), fontsize=10)
        legend = []
        figure.caption = "CREr of each corruption class, with all models on one axis."
        if {"OOD", "ID"} <= {line.setting for line in lines}:
            figure.caption += " The amount by which an outlined bar exceeds the filled one is the cost of fine-tuning."
    else:
        figure, axes = new_figure(5.0, 3.4)
        heights += _bars(figure, axes[0], lines, families, crer, styles, by_setting)
        legend = [(name, Style(style.colour, "s"), True) for name, style in by_name.items()]
        figure.caption = "Mean CREr (CRE divided by the clean EPE) over the corruptions of each class."
        if len(shown) < len(lowest):
            part = f"the {len(shown)} of {len(lowest)} models with the lowest error"
            axes[0].set_title(part, fontsize=9)
            figure.caption += f" It shows {part}."
    if by_setting:
        settings = dict.fromkeys(line.setting for line in lines)
        legend += [(setting, Style(OTHER.colour, "s"), setting != "ID") for setting in settings]
    ends = [end for panel in axes for end in panel.dataLim.intervaly]
    for panel in axes:
        panel.set_xlim(-0.6, len(families) - 0.4)
        panel.set_ylim(fair_limits(heights, LEAST_CRER, ends=ends, zero=True))
        panel.set_ylabel("CREr")
    if any(crer[line].ends("crer", family) for line in lines for family in families):
        figure.caption += f" {WITH_INTERVALS}"
    figure.explain(legend, styling.legend)
    return figure


def _bars(
    figure: MarkedFigure,
    panel: Axes,
    lines: Sequence[LineKey],
    families: list[str],
    crer: Mapping[LineKey, Numbers],
    styles: Mapping[LineKey, Style],
    by_setting: bool,
) -> list[float]:
    """Draw a bar for each line in each family; with `by_setting`, in-domain bars are outlined. Return the heights."""
    width = 0.8 / max(2, len(lines))
    drawn: list[float] = []
    for index, line in enumerate(lines):
        known = crer[line].family_crer()
        heights = [known.get(family, np.nan) for family in families]
        at = np.arange(len(families)) + (index - (len(lines) - 1) / 2) * width
        colour = styles[line].colour
        bars = panel.bar(
            at,
            heights,
            0.92 * width,
            color="white" if by_setting and line.setting == "ID" else colour,
            edgecolor=colour,
            linewidth=0.9,
        )
        for bar, family, height in zip(bars, families, heights, strict=True):
            if np.isnan(height):
                continue
            ends = crer[line].ends("crer", family)
            if ends is not None:
                panel.plot([bar.get_x() + bar.get_width() / 2] * 2, ends, color="#000000", linewidth=0.9)
            drawn.append(height)
            value = ("CREr", f"{height:.2f}{ends_text(ends)}")
            figure.mark(bar, [Mark(line.model, line.setting, (("class", FAMILY_LABELS[family]), value))])
    panel.set_xticks(range(len(families)), [FAMILY_LABELS[family] for family in families], fontsize=8)
    panel.tick_params(axis="y", labelsize=8)
    panel.grid(False, axis="x")
    if panel.dataLim.y0 < 0:
        panel.axhline(0, color="#000000", linewidth=0.8)
    return drawn
