"""Which tables and figures runs and the published results give together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import polars as pl

from ..errors import UsageError, unknown_name
from .analysis_tables import anatomy_table, effective_table, means_table, observations_table
from .costs import run_costs
from .published import published_costs, published_results
from .runs import run_names, run_results
from .table import Table
from .tables import TABLES, build_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..runner.result import Result

ALL_TABLES = (*TABLES, "means", "effective", "anatomy", "observations")


def results_of(runs: Sequence[Result], published: bool) -> pl.DataFrame:
    """Results of runs, after the published ones where wanted: `results.RESULT_SCHEMA`."""
    return pl.concat(([published_results()] if published else []) + [run_results(runs)])


def tables_of(
    runs: Sequence[Result], *, published: bool, wanted: Sequence[str] | None = None, seed: int = 0
) -> list[Table]:
    """Tables of runs.

    Args:
        runs: none or more.
        published: whether the paper's results stand beside them.
        wanted: of `ALL_TABLES`; by default all that these runs can fill.
        seed: of the bootstrap behind the intervals.

    Raises:
        UsageError: an unknown table, or a wanted one that nothing belongs into.
    """
    for name in wanted or ():
        if name not in ALL_TABLES:
            raise unknown_name("table", name, ALL_TABLES)
    results = results_of(runs, published)
    costs = published_costs() if published else {}
    makers: dict[str, Callable[[], list[Table]]] = {
        name: lambda name=name: [build_table(name, results, costs, run_costs(runs))]  # type: ignore[misc]
        for name in TABLES
    }
    makers |= {
        "means": lambda: [means_table(_some(runs, "means"), seed=seed)],
        "effective": lambda: _by_sample_set(results, effective_table),
        "anatomy": lambda: [anatomy_table(_some(runs, "anatomy"))],
        "observations": lambda: _by_sample_set(
            results, lambda part: observations_table(part, costs if "paper" in set(part["sample_set"]) else {})
        ),
    }
    if wanted is not None:
        return [table for name in wanted for table in makers[name]()]
    tables: list[Table] = []
    for name in ALL_TABLES:
        try:
            tables += makers[name]()
        except UsageError:
            # Not everything can be made of every run; what was not asked for by name is left out.
            continue
    return tables


def figures_of(runs: Sequence[Result], *, published: bool) -> dict[str, Figure]:
    """Every figure that the runs, and the published results where wanted, give."""
    from .figures import all_figures

    rows = {name: run.rows for name, run in zip(run_names(runs), runs, strict=True)}
    return all_figures(results_of(runs, published), rows)


def _some(runs: Sequence[Result], table: str) -> Sequence[Result]:
    if not runs:
        raise UsageError(f"the table '{table}' is made from runs: name at least one")
    return runs


def _by_sample_set(results: pl.DataFrame, make: Callable[[pl.DataFrame], Table]) -> list[Table]:
    """One table per set of comparable results that has enough models; an error where none has."""
    tables, reason = [], UsageError("there are no results")
    for frames in dict.fromkeys(results["sample_set"]):
        try:
            tables.append(make(results.filter(sample_set=frames)))
        except UsageError as error:
            reason = error
    if not tables:
        raise reason
    return tables
