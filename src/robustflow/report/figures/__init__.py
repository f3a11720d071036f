"""Figures of results and runs, in PNG, SVG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import polars as pl
from matplotlib.figure import Figure

from ...analysis.published.tables import PAPER
from ...errors import UsageError
from .canvas import FILE_FORMATS, figure_bytes, write_figures
from .clean_against_cre import clean_against_cre
from .crer_by_family import crer_by_family
from .displacement_histogram import displacement_figure
from .effective_trend import effective_trend
from .marks import MarkedFigure
from .relations import relations
from .severity_curves import severity_curves

__all__ = [
    "FILE_FORMATS",
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

_OF_RESULTS: dict[str, Callable[[pl.DataFrame], MarkedFigure]] = {
    "clean_against_cre": clean_against_cre,
    "crer_by_family": crer_by_family,
    "relations": relations,
    "effective_trend": effective_trend,
}


def all_figures(results: pl.DataFrame, runs: Mapping[str, pl.DataFrame]) -> dict[str, Figure]:
    """Every figure that these results and runs (name -> rows) can give, by name.

    Results measured on other frames are not drawn together: the figures of the published values and of each sample
    set are separate, the latter with the number of the set in their names.
    """
    figures: dict[str, Figure] = {}
    by_frames = figures_by_sample_set(results)
    for index, (frames, drawn) in enumerate(by_frames.items()):
        suffix = "" if frames == PAPER else f"_runs_{index}" if PAPER in by_frames else f"_{index}"
        figures |= {name + suffix: figure for name, figure in drawn.items()}
    for metric in ("rcre", "epe"):
        try:
            figures[f"severity_{metric}"] = severity_curves(runs, metric)
        except UsageError:
            continue
    return figures


def figures_by_sample_set(results: pl.DataFrame) -> dict[str, dict[str, MarkedFigure]]:
    """Sample set -> the figures of results by name, of all benchmarks but GoPro-FC, which has no ground truth."""
    with_truth = results.filter(pl.col("benchmark") != "gopro-fc")
    figures: dict[str, dict[str, MarkedFigure]] = {}
    for frames in dict.fromkeys(with_truth["sample_set"]):
        figures[frames] = {}
        for name, draw in _OF_RESULTS.items():
            try:
                figures[frames][name] = draw(with_truth.filter(sample_set=frames))
            except UsageError:
                # Not every set of results has what each figure shows; the caller sees what there is.
                continue
    return figures
