"""Effective robustness drawn: corrupted against clean EPE, with the trend through all models of a setting."""

from __future__ import annotations

import numpy as np
import polars as pl
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ...analysis.effective import effective_robustness
from ...analysis.labels import SETTING_LABELS
from ...figure_style import default_style
from ...text import name_text
from .canvas import KIND_COLOURS, kind_of, panel_figure, set_heading, spread_labels
from .files import settle_layout
from .marks import Mark, MarkedFigure


@default_style()
def effective_trend(results: pl.DataFrame, *, together: bool = False) -> MarkedFigure:
    """One panel per setting; a model's printed factor is its EPE divided by what the trend of the others predicts.

    With `together` there is one trend through the models of all settings.

    Raises:
        UsageError: too few models, see `effective_robustness`.
    """
    table = effective_robustness(results, by_setting=not together)
    table = table.with_columns(panel=pl.lit("") if together else pl.col("setting"))
    titles = list(dict.fromkeys(table["panel"]))
    figure, axes = panel_figure(len(titles))
    for panel, title in zip(axes, titles, strict=True):
        models = table.filter(panel=title)
        clean, epe = models["epe_clean"].to_numpy(), models["epe"].to_numpy()
        panel.set_xscale("log")
        panel.set_yscale("log")
        for row in models.iter_rows(named=True):
            point = panel.scatter(row["epe_clean"], row["epe"], s=30, color=KIND_COLOURS[kind_of(row["model"])])
            texts = (f"{row['epe_clean']:.2f} px", f"{row['epe']:.2f} px", f"{row['expected']:.2f} px")
            values = tuple(zip(("clean EPE", "corrupted EPE", "expected"), texts, strict=True))
            figure.mark(
                point,
                [Mark(row["model"], row["setting"], (*values, ("factor", f"{row['factor']:.2f}")))],
            )
        line = np.polyfit(np.log(clean), np.log(epe), 1)
        ends = np.array([clean.min() * 0.9, clean.max() * 1.1])
        panel.plot(ends, np.exp(np.polyval(line, np.log(ends))), color="black", linewidth=1)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter() if len(models) > 20 else ScalarFormatter())
            axis.set_tick_params(which="both", labelsize=7)
        panel.margins(0.12)
        panel.set_xlabel("clean EPE (px)")
        panel.set_ylabel("corrupted EPE (px)")
        panel.set_title(
            f"{name_text(SETTING_LABELS.get(title, title))}: R² = {models['r_squared'][0]:.2f}".removeprefix(": "),
            fontsize=10,
        )
    set_heading(figure, "Effective robustness: below the line is more robust than the clean error predicts")
    settle_layout(figure)
    for panel, title in zip(axes, titles, strict=True):
        models = table.filter(panel=title)
        labels = [
            (row["epe_clean"], row["epe"], f"{row['model']} ×{row['factor']:.2f}")
            for row in models.iter_rows(named=True)
        ]
        named = zip(models["model"], models["setting"], spread_labels(panel, labels), strict=True)
        for model, setting, text in named:
            figure.mark(text, [Mark(model, setting)])
    return figure
