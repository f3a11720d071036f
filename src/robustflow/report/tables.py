"""Select the tables and figures that can be made from runs and the published results: a registry of functions, each of
which makes the tables of one name from what is wanted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.errors import UsageError
from ..core.plugins import Registry
from ..run.displacement import displacements_of
from .table import Table, Wanted, results_of

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
            tables += TABLES.get(name)(given) if wanted is not None or name != ROW else []
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


def figures_of(runs: Sequence[Run], *, published: bool) -> dict[str, Figure]:
    """Draw every figure that the runs and, if requested, the published results allow. Runs on the same
    frames share a figure; runs that are not ranked appear only in figures with one curve per run."""
    from .figures import all_figures, displacement_figure
    from .figures.curves import MOST_LINES

    figures = all_figures(results_of(runs, published, intervals=True))
    moved = displacements_of(runs)
    if 0 < len(moved) <= MOST_LINES:
        figures["displacement"] = displacement_figure(moved)
    return figures
