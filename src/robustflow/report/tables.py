"""Select the tables and figures that can be made from runs and the published results: a registry of functions, each of
which makes the tables of one name from what is wanted."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from ..core.errors import UsageError
from ..core.plugins import Registry
from ..core.text import joined, plain
from ..run.comparable import run_names, sample_set
from ..run.displacement import displacements_of
from ..stats.lines import lines_of
from ..stats.published.tables import PAPER, published_frame
from .table import Table, Wanted, run_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..run.run import Run


ROW = "row"
TABLES: Registry[Callable[[Wanted], list[Table]]] = Registry("table")
for _name, _module in {
    **dict.fromkeys(("epe", "cre", "rcre", "gopro-rcre", "cost"), "paper_tables"),
    **dict.fromkeys(("means", "uncoupled", "effective"), "run_tables"),
    **dict.fromkeys(("attacks", "security", "corruptions-and-attacks"), "attack_tables"),
    ROW: "run_tables",
}.items():
    TABLES.add(_name, f"{__package__}.{_module}:{_name.replace('-', '_')}")


def tables_of(runs: Sequence[Run], *, published: bool, wanted: Sequence[str] | None = None) -> list[Table]:
    """Make the tables with these names; by default, every table that can be made, except the one that repeats the
    means as a row."""
    given = Wanted(runs, published)
    tables: list[Table] = []
    for name in TABLES if wanted is None else wanted:
        try:
            made = TABLES.get(name)(given) if wanted is not None or name != ROW else []
            if wanted is not None:
                _check_shown(name, given, made)
            tables += made
        except UsageError:
            if wanted is not None:
                raise
            # otherwise, it cannot be made from these runs
    counts: Counter[str] = Counter()
    for index, table in enumerate(tables):
        counts[table.name] += 1  # labels and file names refer to tables by name
        name = table.name if counts[table.name] == 1 else f"{table.name}-{counts[table.name]}"
        tables[index] = replace(table.without_empty_columns(), name=name)
    return tables


def _check_shown(name: str, wanted: Wanted, tables: Sequence[Table]) -> None:
    """Raise a UsageError if a table of models shows none of the runs, or none of the published results; warn of other
    runs that it neither shows nor names in a remark."""
    lines = [line for table in tables for line in table.lines]
    results = [line.result for line in lines if line.result is not None]
    keys = {(result.sample_set, result.model) for result in results}
    # Tables without results are of runs alone: a line, a section or a table for each.
    labels = {line.label for line in lines} | {section.title for table in tables for section in table.sections}
    labels = set() if results else labels | {table.title.partition(" on ")[2] for table in tables}
    runs = zip(map(sample_set, wanted.runs), run_names(wanted.runs), strict=True)
    absent = [plain(name) for of, name in runs if (of, name) not in keys and plain(name) not in labels]
    if not results and len(absent) == len(wanted.runs):
        return  # its lines are not models
    if wanted.published and not any(result.sample_set == PAPER for result in results):
        raise UsageError("--published", f"'{name}' shows none of the published results: omit it, or this table")
    if absent and len(absent) == len(wanted.runs):
        raise UsageError("--table", f"'{name}' shows none of the runs ({joined(absent)}): omit them, or this table")
    remarks = " ".join(remark for table in tables for remark in table.remarks)
    if unnamed := [name for name in absent if name not in remarks]:
        warnings.warn(f"table '{name}' has no value of {joined(unnamed)}, and leaves this out", stacklevel=3)


def figures_of(runs: Sequence[Run], *, published: bool) -> dict[str, Figure]:
    """Draw every figure that the runs and, if requested, the published results allow. Runs on the same
    frames share a figure; runs that are not ranked appear only in figures with one curve per run."""
    from .figures import all_figures, displacement_figure
    from .figures.curves import MOST_LINES

    frame = run_frame(runs, published, intervals=True)
    figures = all_figures(lines_of(pl.concat([*[published_frame()] * published, frame])))
    moved = displacements_of(runs)
    if 0 < len(moved) <= MOST_LINES:
        figures["displacement"] = displacement_figure(moved)
    return figures
