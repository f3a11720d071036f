"""The paper's figure of CREr by class of corruption, out-of-domain against in-domain."""

from __future__ import annotations

from statistics import fmean

import numpy as np
import polars as pl

from ...analysis.labels import FAMILY_LABELS
from ...analysis.results import CLEAN, SETTINGS, values_of
from ...corruptions.names import MEMBERS
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text
from .canvas import ORANGE, SETTING_COLOURS, new_figure
from .marks import Mark, MarkedFigure

REPRESENTATIVE = ("SAMFlow-H", "CSFlow", "ARFlow")


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
def crer_by_family(results: pl.DataFrame, models: tuple[str, ...] | None = None) -> MarkedFigure:
    """Bars of CREr per family, one panel per model, one colour per setting.

    Args:
        results: with EPE per corruption.
        models: which; by default the paper's example models (Fig. 1) and those not in the paper, or all if there are
            none of these; at most nine.

    Raises:
        UsageError: none of the models has a clean EPE.
    """
    crer = family_crer(results)
    if models is None:
        own = [model for setting, model in crer if setting not in SETTINGS]
        chosen = [model for _, model in crer if model in (*REPRESENTATIVE, *own)]
        models = (*REPRESENTATIVE, *own) if chosen else tuple(model for _, model in crer)
    shown = [model for model in dict.fromkeys(models) if any(m == model for _, m in crer)][:9]
    if not shown:
        raise UsageError("no CREr to draw: none of these models has a clean EPE")
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = new_figure(3.9 * columns, 3.0 * rows + 0.4, rows, columns)
    for extra in axes[len(shown) :]:
        extra.remove()
    for panel, model in zip(axes, shown, strict=False):
        settings = [setting for setting, m in crer if m == model]
        families = [family for family in MEMBERS if any(family in crer[s, model] for s in settings)]
        width = 0.8 / len(settings)
        for index, setting in enumerate(settings):
            heights = [crer[setting, model].get(family, np.nan) for family in families]
            at = np.arange(len(families)) + (index - (len(settings) - 1) / 2) * width
            bars = panel.bar(at, heights, width, color=SETTING_COLOURS.get(setting, ORANGE), label=name_text(setting))
            for bar, family, height in zip(bars, families, heights, strict=True):
                if np.isnan(height):
                    continue
                figure.mark(bar, [Mark(model, setting, (("class", FAMILY_LABELS[family]), ("CREr", f"{height:.2f}")))])
            panel.bar_label(bars, fmt="%.2g", fontsize=6, padding=1)
        panel.set_xticks(range(len(families)), [FAMILY_LABELS[family] for family in families], fontsize=7)
        panel.set_title(name_text(model), fontsize=10)
        panel.set_ylabel("CREr")
        panel.grid(False, axis="x")
        panel.margins(y=0.12)
        panel.legend(frameon=False, fontsize=7)
    return figure
