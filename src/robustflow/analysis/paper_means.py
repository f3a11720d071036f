"""The averages of a run that are shown next to published ones."""

from __future__ import annotations

import polars as pl

from ..metrics.rows import CLEAN
from ..metrics.summary import Scores
from ..runs.run import Run


def paper_means(run: Run) -> Scores:
    """The averages of a run next to published ones: the paper's mean where the run has it."""
    return run.summary.paper or run.summary


def paper_rows(run: Run) -> pl.DataFrame:
    """The rows that `paper_means` are over."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.summary.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages are over all of the paper's corruptions and others."""
    return run.summary.paper is not None and len(run.summary.averaged_over) > len(run.summary.paper_over)
