"""Figures of results and runs, as PNG, SVG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Container
from contextlib import suppress

from matplotlib.figure import Figure

from ...core.errors import UsageError
from ...data.benchmarks import benchmark_facts
from ...stats.lines import Lines, by_sample_set, ranked
from ...stats.published.tables import PAPER
from .canvas import FILE_FORMATS, MarkedFigure, figure_bytes, write_figures
from .crer_by_family import crer_by_family
from .curves import displacement_figure, severity_curves
from .scatter import clean_against_cre, effective_trend, relations
from .styles import PLAIN_STYLES, FigureStyles

__all__ = [
    "FILE_FORMATS",
    "OF_ONE_MODEL",
    "FigureStyles",
    "all_figures",
    "clean_against_cre",
    "crer_by_family",
    "displacement_figure",
    "effective_trend",
    "figure_bytes",
    "figures_by_sample_set",
    "relations",
    "severity_curves",
    "write_figures",
]

OF_ONE_MODEL = ("crer_by_family",)
"""Figures that show something about a single model; the others compare models."""

_DRAWN: dict[str, Callable[[Lines, FigureStyles], MarkedFigure]] = {
    "clean_against_cre": clean_against_cre,
    "crer_by_family": crer_by_family,
    "relations": relations,
    "effective_trend": effective_trend,
}


def all_figures(lines: Lines) -> dict[str, Figure]:
    """Draw every figure that can be made from these results, by name. Results that are not ranked appear only in
    figures with one curve per run.
    """
    figures: dict[str, Figure] = {}
    sets = by_sample_set(lines)
    numbers = {of: number for number, of in enumerate((of for of in sets if of != PAPER), 1)}
    suffixes = {of: f"_{number}" if len(sets) > 1 else "" for of, number in numbers.items()} | {PAPER: ""}
    for of, drawn in figures_by_sample_set(ranked(lines)).items():
        figures |= {name + suffixes[of]: figure for name, figure in drawn.items()}
    for of, part in sets.items():
        runs = {key.model: numbers for key, numbers in part.items() if numbers.is_run}
        for metric in ("rcre", "epe"):
            with suppress(UsageError):  # too many runs, or no run measured the metric
                figures[f"severity_{metric}{suffixes[of]}"] = severity_curves(runs, metric)
    return figures


def figures_by_sample_set(
    lines: Lines, styling: FigureStyles = PLAIN_STYLES, names: Container[str] = frozenset(_DRAWN)
) -> dict[str, dict[str, MarkedFigure]]:
    """Draw the figures of results, by name, for each sample set of a benchmark with ground truth."""
    figures: dict[str, dict[str, MarkedFigure]] = {}
    with_flow = {key: numbers for key, numbers in lines.items() if benchmark_facts(key.benchmark).has_flow}
    for of, part in by_sample_set(with_flow).items():
        figures[of] = {}
        for name, draw in ((name, draw) for name, draw in _DRAWN.items() if name in names):
            with suppress(UsageError):  # Some sets of results lack the data for some figures.
                figures[of][name] = draw(part, styling)
    return figures
