"""Select the tables and figures that can be made from runs and the published results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.errors import UsageError, unknown_name
from ..core.text import first_of, plain
from ..stats.anatomy import displacements_of
from ..stats.conditions import seed_groups
from ..stats.model_result import ModelResult, by_frames, not_ranked, ranked
from ..stats.published.tables import PAPER, published_results
from ..stats.results import on_benchmark
from ..stats.run_results import run_results
from .analysis_tables import (
    FLAT_AND_DEPTH,
    anatomy_table,
    depth_table,
    effective_table,
    means_table,
)
from .attack_table import ATTACK_TABLES, attack_tables
from .confidence_table import uncoupled_table
from .table import Table
from .tables import TABLES, build_table, runs_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..run.run import Run

ROW = "row"
ALL_TABLES = (*TABLES, "means", "uncoupled", "effective", "anatomy", *ATTACK_TABLES, FLAT_AND_DEPTH)
"""Tables made by default, if none is requested by name. `ROW` is not included because it repeats the means."""
_MOST_NAMED = 4


def results_of(runs: Sequence[Run], published: bool) -> list[ModelResult]:
    """Return the published results, if requested, followed by the results of the runs."""
    return [*(published_results() if published else []), *run_results(runs, published)]


def tables_of(
    runs: Sequence[Run],
    *,
    published: bool,
    wanted: Sequence[str] | None = None,
    seed: int = 0,
    only_own: bool = False,
) -> list[Table]:
    """Make the tables of runs."""
    for name in wanted or ():
        if name not in (*ALL_TABLES, ROW):
            raise unknown_name("table", name, (*ALL_TABLES, ROW))
    results = results_of(runs, published)
    about = [line for line in results if line.frames != PAPER] if only_own else results
    seeds = seed_groups(runs)

    def made(name: str) -> list[Table]:
        if name in TABLES:
            return [build_table(name, results, seeds)]
        if name == "effective":
            return _tables_by_sample_set(about, effective_table)
        if not runs:
            raise UsageError(f"the table '{name}' requires runs: give at least one run")
        if name in ATTACK_TABLES:
            return attack_tables(name, runs, seed)
        if name == "anatomy":
            return [anatomy_table(runs)]
        if name == FLAT_AND_DEPTH:
            return [depth_table(runs, seed)]
        of_runs = run_results(runs)
        if name == "means":
            return [means_table(of_runs, seed=seed, seeds=seeds)]
        if name == "uncoupled":
            return [_naming_excluded(uncoupled_table(of_runs), of_runs)]
        return [replace(runs_table(of_runs, seeds), name=ROW)]

    if wanted is not None:
        return [table.without_empty_columns() for name in wanted for table in made(name)]
    tables: list[Table] = []
    for name in ALL_TABLES:
        try:
            tables += made(name)
        except UsageError:
            # unless requested by name, tables that cannot be made from these runs are skipped
            continue
    return [table.without_empty_columns() for table in tables]


def figures_of(runs: Sequence[Run], *, published: bool) -> dict[str, Figure]:
    """Draw every figure that the runs and, if requested, the published results allow. Runs on the same
    frames share a figure; runs that are not ranked appear only in figures with one curve per run."""
    from .figures import all_figures, displacement_figure
    from .figures.displacement_histogram import MOST_LINES

    figures = all_figures(results_of(runs, published))
    moved = displacements_of(runs)
    if 0 < len(moved) <= MOST_LINES:
        figures["displacement"] = displacement_figure(moved)
    return figures


def _tables_by_sample_set(
    results: Sequence[ModelResult], make: Callable[[Sequence[ModelResult]], Table]
) -> list[Table]:
    """Make one table for each set of comparable results with enough models. Its title names the set, and a remark lists
    the runs omitted because they are not ranked. Raise an error if no set has enough models."""
    tables: list[Table] = []
    reason = UsageError("there are no results")
    for frames, lines in by_frames(results).items():
        part = ranked(lines)
        try:
            if not any(line.values for line in part):
                continue
            table = make(part)
        except UsageError as error:
            reason = error
        else:
            name = f"{table.name}-{len(tables) + 1}" if tables else table.name
            title = f"{table.title}: {_described_models(frames, part)}"
            tables.append(_naming_excluded(replace(table, name=name, title=title), lines))
    if not tables:
        raise reason
    return tables


def _naming_excluded(table: Table, results: Sequence[ModelResult]) -> Table:
    """Append a remark with the omitted runs to a table whose statements generalise over models."""
    if not (reasons := not_ranked(results)):
        return table
    return replace(table, remarks=(*table.remarks, f"Left out of trends and correlations: {'; '.join(reasons)}."))


def _described_models(frames: str, part: Sequence[ModelResult]) -> str:
    if frames == PAPER:
        return "published models"
    models = [plain(name) for name in dict.fromkeys(line.name for line in part)]
    return on_benchmark(first_of(models, _MOST_NAMED), part[0].benchmark)
