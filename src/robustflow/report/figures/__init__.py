"""Figures of results and runs, in PNG, SVG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import polars as pl
from matplotlib.figure import Figure

from ...analysis.model_result import ModelResult, by_frames
from ...analysis.published.tables import PAPER, of_paper
from ...benchmarks import benchmark_facts
from ...errors import UsageError
from .clean_against_cre import clean_against_cre
from .crer_by_family import crer_by_family
from .displacement_histogram import displacement_figure
from .effective_trend import effective_trend
from .files import FILE_FORMATS, figure_bytes, write_figures
from .marks import MarkedFigure
from .relations import relations
from .severity_curves import severity_curves
from .styles import Looks

__all__ = [
    "FILE_FORMATS",
    "Looks",
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

_DRAWN: dict[str, Callable[[Sequence[ModelResult], Looks, bool], MarkedFigure]] = {
    "clean_against_cre": lambda results, looks, together: clean_against_cre(results, looks, together=together),
    "crer_by_family": lambda results, looks, together: crer_by_family(results, None, looks),
    "relations": lambda results, looks, together: relations(results, looks, together=together),
    "effective_trend": lambda results, looks, together: effective_trend(results, looks, together=together),
}


def all_figures(
    results: Sequence[ModelResult],
    sample_sets: Mapping[str, Mapping[str, pl.DataFrame]],
    looks: Mapping[str, Looks] | None = None,
) -> dict[str, Figure]:
    """Every figure that can be made from these results and runs (sample set -> name -> rows), by name.

    Results measured on other frames are not drawn together: the figures of the published values and of each sample
    set are separate, the latter with the number of the set in their names. Own models on the same frames are drawn
    together, whatever their settings. `looks` by sample set.
    """
    looks = looks or {}
    figures: dict[str, Figure] = {}
    of_results = figures_by_sample_set(results, looks)
    for index, (frames, drawn) in enumerate(of_results.items()):
        suffix = "" if frames == PAPER else f"_runs_{index}" if PAPER in of_results else f"_{index}"
        figures |= {name + suffix: figure for name, figure in drawn.items()}
    for index, (frames, runs) in enumerate(sample_sets.items(), 1):
        suffix = f"_{index}" if len(sample_sets) > 1 else ""
        styles = looks[frames].styles if frames in looks else {}
        for metric in ("rcre", "epe"):
            try:
                figures[f"severity_{metric}{suffix}"] = severity_curves(runs, metric, Looks(styles))
            except UsageError:
                continue
    return figures


def figures_by_sample_set(
    results: Iterable[ModelResult], looks: Mapping[str, Looks] | None = None
) -> dict[str, dict[str, MarkedFigure]]:
    """Sample set -> the figures of results by name, of all benchmarks with ground truth; `looks` by sample set."""
    figures: dict[str, dict[str, MarkedFigure]] = {}
    for frames, part in by_frames(line for line in results if benchmark_facts(line.benchmark).has_flow).items():
        figures[frames] = {}
        for name, draw in _DRAWN.items():
            try:
                figures[frames][name] = draw(part, (looks or {}).get(frames, Looks()), not _by_setting(part))
            except UsageError:
                # Not every set of results has what each figure needs; the result shows which could be made.
                continue
    return figures


def _by_setting(results: Sequence[ModelResult]) -> bool:
    """Whether one panel per setting is more informative than one for all: for the paper's values, and if a model was
    measured in two settings."""
    models = {(line.setting, line.name) for line in results}
    return of_paper(results) or len({name for _, name in models}) < len(models)
