"""Which tables and figures can be made from runs and the published results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from ..analysis.conclusion import conclusions
from ..analysis.conditions import SeedGroup, seed_groups
from ..analysis.cost_ranks import run_costs
from ..analysis.displacements import displacements_of
from ..analysis.doubts import doubted_runs, sound_results
from ..analysis.labels import on_benchmark
from ..analysis.observations.verdict import UNKNOWN
from ..analysis.published.tables import PAPER, published_costs, published_results
from ..analysis.run_names import run_names
from ..analysis.scores import coverage_of, run_results
from ..errors import UsageError, unknown_name
from ..runs.comparable import sample_set
from ..text import plain
from .analysis_tables import anatomy_table, effective_table, means_table, observations_table
from .table import Table, with_doubt
from .tables import TABLES, build_table
from .uncoupled_table import uncoupled_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..runs.run import Run

ROW = "row"
ALL_TABLES = (*TABLES, "means", "uncoupled", "effective", "anatomy", "observations", ROW)
_MOST_NAMED = 4


def results_of(runs: Sequence[Run], published: bool) -> pl.DataFrame:
    """Results of runs, after the published ones if requested: `results.RESULT_SCHEMA`."""
    return pl.concat(([published_results()] if published else []) + [run_results(runs, published)])


def tables_of(
    runs: Sequence[Run],
    *,
    published: bool,
    wanted: Sequence[str] | None = None,
    seed: int = 0,
    only_own: bool = False,
) -> list[Table]:
    """Tables of runs.

    Args:
        runs: none or more.
        published: whether the paper's results are shown as well.
        wanted: names of `ALL_TABLES`; by default all that these runs can fill.
        seed: of the bootstrap behind the intervals.
        only_own: whether effective robustness and observations are left out for the paper's models.

    Raises:
        UsageError: an unknown table, or a wanted one that would be empty.
    """
    for name in wanted or ():
        if name not in ALL_TABLES:
            raise unknown_name("table", name, ALL_TABLES)
    results = results_of(runs, published)
    costs = published_costs() if published else {}
    about = results.filter(pl.col("sample_set") != PAPER) if only_own else results

    doubted, coverage = doubted_runs(runs), coverage_of(runs)
    sound, seeds = sound_results(about, doubted), seed_groups(runs)
    pairs = {sample_set(run): run.summary.samples for run in runs}

    def all_observations(part: pl.DataFrame) -> Table:
        frames = str(part["sample_set"][0])
        return observations_table(part, costs if frames == PAPER else {}, pairs.get(frames))

    def computable_observations(part: pl.DataFrame) -> Table:
        table = all_observations(part)
        if all(line.cells[0].text == UNKNOWN for section in table.sections for line in section.lines):
            raise UsageError("none of the paper's observations can be computed from these results")
        return table

    makers: dict[str, Callable[[], list[Table]]] = {
        name: lambda name=name: [build_table(name, results, costs, run_costs(runs), doubted, coverage, seeds)]  # type: ignore[misc]
        for name in TABLES
    }
    makers |= {
        "means": lambda: [means_table(_some(runs, "means"), seed=seed, seeds=seeds)],
        ROW: lambda: [_row_table(_some(runs, ROW), seeds, doubted)],
        "uncoupled": lambda: [_without(uncoupled_table(_some(runs, "uncoupled"), doubted), doubted)],
        "effective": lambda: _by_sample_set(sound, effective_table, doubted),
        "anatomy": lambda: [anatomy_table(_some(runs, "anatomy"))],
        "observations": lambda: _by_sample_set(sound, all_observations, doubted),
    }
    if wanted is not None:
        return _concluded([table for name in wanted for table in makers[name]()], runs)
    makers["observations"] = lambda: _by_sample_set(sound, computable_observations, doubted)
    tables: list[Table] = []
    for name in ALL_TABLES:
        if name == ROW:  # the means again
            continue
        try:
            tables += makers[name]()
        except UsageError:
            # Not everything can be made from every run; what was not requested by name is left out.
            continue
    return _concluded(tables, runs)


def _concluded(tables: list[Table], runs: Sequence[Run]) -> list[Table]:
    """The tables without columns of dashes; the last one of RCRE ends with what can be concluded from runs without
    ground truth."""
    tables = [table.without_empty_columns() for table in tables]
    last = next((index for index in reversed(range(len(tables))) if tables[index].name in ("rcre", "means")), None)
    if last is not None:
        tables[last] = replace(tables[last], remarks=(*tables[last].remarks, *conclusions(runs)))
    return tables


def figures_of(runs: Sequence[Run], *, published: bool) -> dict[str, Figure]:
    """Every figure that can be made from the runs, and from the published results if requested. Runs on the same frames
    are drawn together; doubted ones only where each run has a curve."""
    from ..analysis.uncertainty.of_runs import interval_ends
    from .figures import Looks, all_figures, displacement_figure
    from .figures.displacement_histogram import MOST_LINES

    of_frames: dict[str, dict[str, Run]] = {}
    for run, name in zip(runs, run_names(runs), strict=True):
        of_frames.setdefault(sample_set(run), {})[name] = run
    looks = {
        frames: Looks(intervals={name: interval_ends(run, beside_published=published) for name, run in group.items()})
        for frames, group in of_frames.items()
    }
    rows = {frames: {name: run.rows for name, run in group.items()} for frames, group in of_frames.items()}
    figures = all_figures(sound_results(results_of(runs, published), doubted_runs(runs)), rows, looks)
    moved = displacements_of(runs)
    if 0 < len(moved) <= MOST_LINES:
        figures["displacement"] = displacement_figure(moved)
    return figures


def _some(runs: Sequence[Run], table: str) -> Sequence[Run]:
    if not runs:
        raise UsageError(f"the table '{table}' is made from runs: name at least one")
    return runs


def _row_table(runs: Sequence[Run], seeds: Sequence[SeedGroup], doubted: Mapping[tuple[str, str], str]) -> Table:
    """The means as lines for a table of the reader's own; a line's note says how they were measured."""
    table = means_table(runs, seeds=seeds, brackets=False)
    reasons = {name: reason for (_, name), reason in doubted.items()}
    lines = tuple(
        replace(line, note=with_doubt(line.note, reasons.get(line.label))) for line in table.sections[0].lines
    )
    return replace(table, name=ROW, sections=(replace(table.sections[0], lines=lines),))


def _by_sample_set(
    results: pl.DataFrame, make: Callable[[pl.DataFrame], Table], doubted: Mapping[tuple[str, str], str]
) -> list[Table]:
    """One table per set of comparable results that has enough models, with a title that names the set and the doubted
    runs that are not among the results; raises an error if none has."""
    tables: list[Table] = []
    reason = UsageError("there are no results")
    for frames in dict.fromkeys(results["sample_set"]):
        part = results.filter(sample_set=frames)
        try:
            table = make(part)
        except UsageError as error:
            reason = error
        else:
            name = f"{table.name}-{len(tables) + 1}" if tables else table.name
            title = f"{table.title}: {_whose(frames, part)}"
            of_frames = {key: reason for key, reason in doubted.items() if key[0] == frames}
            tables.append(_without(replace(table, name=name, title=title), of_frames))
    if not tables:
        raise reason
    return tables


def _without(table: Table, doubted: Mapping[tuple[str, str], str]) -> Table:
    """A table of statements about models in general, with a remark that names the runs they leave out."""
    if not doubted:
        return table
    reasons = "; ".join(f"{plain(name)}, because {reason}" for (_, name), reason in doubted.items())
    return replace(table, remarks=(*table.remarks, f"Left out of trends and correlations: {reasons}."))


def _whose(frames: str, part: pl.DataFrame) -> str:
    if frames == PAPER:
        return "published models"
    benchmark, models = part["benchmark"][0], list(dict.fromkeys(part["model"]))
    named, more = models[:_MOST_NAMED], len(models) - _MOST_NAMED
    text = ", ".join(map(plain, named)) + (f" and {more} more" if more > 0 else "")
    return on_benchmark(text, benchmark)
