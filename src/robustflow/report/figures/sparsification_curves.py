"""Sparsification curves: the error after removing the least confident pixels, with one panel per family and one line
per severity."""

from __future__ import annotations

from collections.abc import Sequence

from ...analysis.confidence import ConfidenceScore
from ...analysis.labels import FAMILY_LABELS
from ...errors import UsageError
from ...figure_style import default_style
from .canvas import LEAST_PX, fair_limits, new_figure
from .marks import Mark, MarkedFigure
from .styles import MODEL_STYLES

_REMOVED = tuple(range(0, 100, 10))
_COLUMNS = 4


@default_style()
def sparsification_curves(model: str, scores: Sequence[ConfidenceScore]) -> MarkedFigure:
    """Plot the mean error of the remaining pixels when 0, 10, ... 90 % are removed: least confident first (solid), and
    largest errors first (dashed). All panels have the same axes.
    """
    drawn = [score for score in scores if score.severity is not None and score.by_confidence]
    families = list(dict.fromkeys(score.family for score in drawn))
    if not families:
        raise UsageError("there is no sparsification curve: the run has no confidence or no ground truth")
    figure, axes = new_figure(2.6, 2.3, len(families), _COLUMNS, above=0.3)
    levels = sorted({score.severity for score in drawn if score.severity is not None})
    styles = dict(zip(levels, MODEL_STYLES, strict=False))
    for panel, family in zip(axes, families, strict=True):
        for score in (one for one in drawn if one.family == family):
            assert score.severity is not None
            style = styles[score.severity]
            panel.plot(_REMOVED, score.by_error, color=style.colour, linewidth=1.0, linestyle=(0, (3, 2)))
            (line,) = panel.plot(
                _REMOVED, score.by_confidence, color=style.colour, marker=style.marker, markersize=3.5, linewidth=1.2
            )
            figure.mark(line, [_mark(model, score, place) for place in range(len(_REMOVED))])
        panel.set_title(FAMILY_LABELS[family], fontsize=9)
        panel.set_xlabel("removed (%)", fontsize=8)
        panel.tick_params(labelsize=7.5)
    highest = [value for score in drawn for value in (*score.by_confidence, *score.by_error)]
    for panel in axes:
        panel.set_ylim(fair_limits(highest, LEAST_PX, zero=True))
    axes[0].set_ylabel("EPE of remaining pixels (px)", fontsize=8)
    figure.explain([(f"severity {level}", style, True) for level, style in styles.items()], legend=False)
    figure.caption = (
        f"{model}: mean error of the remaining pixels after removing the least confident ones; dashed: after removing "
        "those with the largest errors. The area between the two is AUSE."
    )
    return figure


def _mark(model: str, score: ConfidenceScore, place: int) -> Mark:
    return Mark(
        model,
        "",
        (
            ("class", FAMILY_LABELS[score.family]),
            ("severity", str(score.severity)),
            ("removed", f"{_REMOVED[place]} %"),
            ("EPE", f"{score.by_confidence[place]:.2f} px"),
            ("oracle", f"{score.by_error[place]:.2f} px"),
        ),
    )
