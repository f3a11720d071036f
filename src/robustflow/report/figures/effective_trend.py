"""Figure of effective robustness: corrupted against clean EPE, with the trend over all models in a setting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ...analysis.effective import effective_robustness
from ...analysis.labels import SETTING_LABELS
from ...analysis.model_result import ModelResult
from ...analysis.published.tables import of_paper
from ...analysis.results import AVERAGE, CLEAN
from ...figure_style import default_style
from ...text import name_text, plain
from .canvas import LONGEST_NAME, WITH_INTERVALS, ends_text, new_figure, set_heading, spread_labels, whiskers
from .files import settle_layout
from .marks import Mark, MarkedFigure
from .styles import FigureStyles, kind_key


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
