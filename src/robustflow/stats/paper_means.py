"""The averages of a run that can be compared with published ones."""

from __future__ import annotations

import polars as pl

from ..metrics.rows import CLEAN
from ..metrics.summary import Scores
from ..run.run import Run


def paper_means(run: Run) -> Scores:
    """Return the averages to show next to published ones: over the paper's corruptions if the run has all of them."""
    return run.summary.paper or run.summary


def paper_rows(run: Run) -> pl.DataFrame:
    """Return the rows that `paper_means` averages."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.summary.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages include all of the paper's corruptions and additional ones."""
    return run.summary.paper is not None and len(run.summary.averaged_over) > len(run.summary.paper_over)
