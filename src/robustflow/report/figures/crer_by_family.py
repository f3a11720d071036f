"""The paper's figure of CREr by class of corruption, out-of-domain against in-domain; and the same of other models."""

from __future__ import annotations

from statistics import fmean

import numpy as np
import polars as pl
from matplotlib.axes import Axes

from ...analysis.labels import FAMILY_LABELS
from ...analysis.published.tables import PAPER
from ...analysis.results import CLEAN, values_of
from ...corruptions.names import MEMBERS
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text
from .canvas import WITH_INTERVALS, ends_text, fair_limits, new_figure
from .marks import Mark, MarkedFigure
from .styles import MODEL_STYLES, OTHER, Looks, Style, told_apart

REPRESENTATIVE = ("SAMFlow-H", "CSFlow", "ARFlow")
LEAST_CRER = 0.5
"""CREr that the axis reaches at least."""

_Key = tuple[str, str]
"""(setting, model)."""


def family_crer(results: pl.DataFrame) -> dict[tuple[str, str], dict[str, float]]:
    """(setting, model) -> family -> mean CREr over the corruptions of the family that were measured."""
    epe = values_of(results, "epe")
    out: dict[tuple[str, str], dict[str, float]] = {}
    for setting, model in dict.fromkeys((s, m) for s, m, _ in epe):
        clean = epe.get((setting, model, CLEAN))
        for family, names in MEMBERS.items():
            values = [epe[setting, model, name] for name in names if (setting, model, name) in epe]
            if clean and values:
                out.setdefault((setting, model), {})[family] = (fmean(values) - clean) / clean
    return out


@default_style()
def crer_by_family(
    results: pl.DataFrame, models: tuple[str, ...] | None = None, looks: Looks | None = None
) -> MarkedFigure:
    """Bars of CREr per family, on one axis.

    Of the paper's values a panel per model, with a bar per setting; of other models all in one panel, a bar per model.

    Args:
        results: with EPE per corruption.
        models: which; by default the paper's example models (Fig. 1), or all if there are none of these; at most eight.
        looks: styles and intervals of the models.

    Raises:
        UsageError: none of the models has a clean EPE, or there is a single bar.
    """
    looks, crer = looks or Looks(), family_crer(results)
    of_paper = PAPER in results["sample_set"]
    if models is None:
        models = REPRESENTATIVE if of_paper else tuple(model for _, model in crer)
    shown = [model for model in dict.fromkeys(models) if any(m == model for _, m in crer)][: len(MODEL_STYLES)]
    if not shown:
        raise UsageError("no CREr to draw: none of these models has a clean EPE")
    keys = [key for model in shown for key in crer if key[1] == model]
    families = [family for family in MEMBERS if any(family in crer[key] for key in keys)]
    if len(keys) * len(families) < 2:
        raise UsageError("one class of corruptions and one model make one bar: measure another, or read the table")
    styles = looks.of(results) if of_paper else told_apart(shown, looks.styles)
    by_setting = of_paper or len(keys) > len(shown)
    reached: list[float] = []
    if of_paper:
        columns = min(3, len(shown))
        rows = -(-len(shown) // columns)
        figure, axes = new_figure(3.9 * columns, 3.0 * rows + 0.4, rows, columns)
        for extra in axes[len(shown) :]:
            extra.remove()
        for panel, model in zip(axes, shown, strict=False):
            drawn = [key for key in keys if key[1] == model]
            reached += _bars(figure, panel, drawn, families, crer, styles, looks, by_setting)
            panel.set_title(name_text(model), fontsize=10)
        axes, legend = axes[: len(shown)], []
        figure.caption = "CREr of each class of corruptions, all models on one axis."
        if {"OOD", "ID"} <= {setting for setting, _ in keys}:
            figure.caption += " What an outlined bar is above its filled one is what fine-tuning costs."
    else:
        figure, axes = new_figure(5.0, 3.4)
        reached += _bars(figure, axes[0], keys, families, crer, styles, looks, by_setting)
        legend = [(model, Style(styles[model].colour, "s"), True) for model in shown]
        figure.caption = "Mean CREr over the corruptions of each class: CRE divided by the clean EPE."
    if by_setting:
        settings = dict.fromkeys(setting for setting, _ in keys)
        legend += [(setting, Style(OTHER.colour, "s"), setting != "ID") for setting in settings]
    for panel in axes:
        panel.set_xlim(-0.6, len(families) - 0.4)
        panel.set_ylim(fair_limits(reached, LEAST_CRER, zero=True))
        panel.set_ylabel("CREr")
    if any(looks.ends(model, "crer", family) for _, model in keys for family in families):
        figure.caption += f" {WITH_INTERVALS}"
    figure.explain(legend, looks.legend)
    return figure


def _bars(
    figure: MarkedFigure,
    panel: Axes,
    keys: list[_Key],
    families: list[str],
    crer: dict[_Key, dict[str, float]],
    styles: dict[str, Style],
    looks: Looks,
    by_setting: bool,
) -> list[float]:
    """A bar of each key in each family, with `by_setting` an outline in-domain. Returns everything the axis must
    hold."""
    width = 0.8 / max(2, len(keys))
    reached: list[float] = []
    for index, (setting, model) in enumerate(keys):
        heights = [crer[setting, model].get(family, np.nan) for family in families]
        at = np.arange(len(families)) + (index - (len(keys) - 1) / 2) * width
        colour = styles[model].colour
        bars = panel.bar(
            at,
            heights,
            0.92 * width,
            color="white" if by_setting and setting == "ID" else colour,
            edgecolor=colour,
            linewidth=0.9,
        )
        for bar, family, height in zip(bars, families, heights, strict=True):
            if np.isnan(height):
                continue
            ends = looks.ends(model, "crer", family)
            if ends is not None:
                panel.plot([bar.get_x() + bar.get_width() / 2] * 2, ends, color="#000000", linewidth=0.9)
            reached += (height, *(ends or ()))
            value = ("CREr", f"{height:.2f}{ends_text(ends)}")
            figure.mark(bar, [Mark(model, setting, (("class", FAMILY_LABELS[family]), value))])
    panel.set_xticks(range(len(families)), [FAMILY_LABELS[family] for family in families], fontsize=8)
    panel.tick_params(axis="y", labelsize=8)
    panel.grid(False, axis="x")
    if min(reached, default=0.0) < 0:
        panel.axhline(0, color="#000000", linewidth=0.8)
    return reached
