"""The averages of a run that can be compared with published ones."""

from __future__ import annotations

import polars as pl

from ..metrics.means import AVERAGE, PAPER
from ..metrics.rows import CLEAN
from ..run.run import Run


def paper_condition(run: Run) -> str:
    """Return the condition of the averages to show next to published ones: over the paper's corruptions if the run has
    all of them."""
    return PAPER if run.measured.paper_over else AVERAGE


def paper_rows(run: Run) -> pl.DataFrame:
    """Return the rows that `paper_condition` names."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.measured.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages include all of the paper's corruptions and additional ones."""
    measured = run.measured
    return bool(measured.paper_over) and len(measured.averaged_over) > len(measured.paper_over)
