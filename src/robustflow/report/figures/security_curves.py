"""Security curves: error by attack budget, with one panel per norm."""

from __future__ import annotations

from collections.abc import Sequence

from ...analysis.labels import METRIC_LABELS, metric_label
from ...analysis.security_curves import CurvePoint
from ...errors import UsageError
from ...figure_style import default_style
from ...text import name_text
from .canvas import ends_text, fair_limits, new_figure
from .marks import Mark, MarkedFigure
from .styles import model_styles

NORMS = {"linf": "largest change", "rms": "root mean square of the change", "area": "share of the pixels"}


@default_style()
def security_figure(points: Sequence[CurvePoint]) -> MarkedFigure:
    """Plot the security curves of a run; hollow markers indicate a warning."""
    if not points:
        raise UsageError("this run has no attacks and therefore no security curves; run it again with --attacks")
    styles = model_styles(point.attack for point in points)
    norms = [norm for norm in NORMS if any(point.norm == norm for point in points)]
    figure, axes = new_figure(4.4, 3.4, len(norms))
    metric = points[0].metric
    reached = [end for point in points for end in (point.error, point.high) if end is not None]
    for panel, norm in zip(axes, norms, strict=True):
        budgets = sorted({point.budget for point in points if point.norm == norm})
        places = {budget: place for place, budget in enumerate(budgets)}
        for name in dict.fromkeys(point.attack for point in points if point.norm == norm):
            curve, style = [point for point in points if point.attack == name], styles[name]
            at = [places[point.budget] for point in curve]
            errors = [point.error for point in curve]
            panel.plot(at, errors, color=style.colour, linewidth=1.2)
            for place, point in zip(at, curve, strict=True):
                fill = "white" if point.warned else style.colour
                drawn = panel.plot(
                    place, point.error, color=style.colour, marker=style.marker, markersize=4.5, markerfacecolor=fill
                )
                figure.mark(drawn[0], [_mark(point)])
            known = [(place, p.low, p.high) for place, p in zip(at, curve, strict=True) if p.low is not None]
            if known:
                where, low, high = zip(*known, strict=True)
                panel.fill_between(where, low, high, color=style.colour, alpha=0.12, linewidth=0)
        panel.set_xticks(list(places.values()), [f"{budget:g}" for budget in budgets])
        panel.set_ylim(fair_limits([0.0, *reached], zero=True))
        panel.set_title(NORMS[norm], fontsize=9)
        panel.set_xlabel("budget (%)" if norm == "area" else "budget (grey levels)", fontsize=8.5)
        panel.set_ylabel(metric_label(metric), fontsize=8.5)
    key = [(name_text(name), style, True) for name, style in styles.items()]
    figure.explain(key, legend=False)
    banded = any(point.low is not None for point in points)
    figure.caption = (
        f"{metric_label(metric)} by budget of each attack; budget 0 refers to the clean frames, and budgets are not "
        "to scale. A steeper curve means a less robust model. Hollow markers indicate a warning."
    ) + (" Bands are 95 % confidence intervals." if banded else "")
    return figure


def _mark(point: CurvePoint) -> Mark:
    ends = None if point.low is None or point.high is None else (point.low, point.high)
    value = f"{point.error:.2f} px{ends_text(ends)}"
    where = (("norm", point.norm), ("budget", f"{point.budget:g}"))
    warning = "yes" if point.warned else "no"
    return Mark(point.attack, "", (*where, (METRIC_LABELS[point.metric], value), ("warning", warning)))
