"""The paper's tables from any results: published values, runs, or both.

A renderer (`robustflow.report.render`) writes what `build_table` makes.
"""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from ..analysis.labels import BENCHMARK_LABELS, FAMILY_LABELS, FAMILY_OF, METRIC_LABELS, SETTING_LABELS, short_label
from ..analysis.published.tables import Cost
from ..analysis.results import AVERAGE, CLEAN
from ..benchmarks import benchmark_facts
from ..corruptions.registry import PAPER_ORDER
from ..errors import UsageError, unknown_name
from ..runs.costs import RunCost
from ..text import plain
from .cost_table import cost_table
from .table import Cell, Column, Line, Section, Table, number_text

TABLES = ("epe", "cre", "rcre", "gopro-rcre", "cost")


def build_table(
    name: str,
    results: pl.DataFrame,
    costs: Mapping[str, Cost] | None = None,
    run_costs: Mapping[tuple[str, str], RunCost] | None = None,
) -> Table:
    """One of the paper's tables, from any results.

    Args:
        name: "epe" (Tab. 2), "cre" (Tab. 7), "rcre" (Tab. 8), "gopro-rcre" (Tab. 4) or "cost" (Tab. 3).
        results: columns of `results.RESULT_SCHEMA`: published, of runs, or both after one another.
        costs: published ones by model, for "cost".
        run_costs: of runs by (sample set, name), for "cost"; runs that are not in it are listed without.

    Raises:
        UsageError: an unknown table, or results without anything that belongs in it.

    >>> from robustflow.analysis.published.tables import published_results
    >>> table = build_table("epe", published_results())
    >>> [section.title for section in table.sections]
    ['Knowledge-driven', 'Out-of-domain (OOD)', 'In-domain (ID)']
    >>> line = next(line for line in table.sections[1].lines if line.label == "SAMFlow-H")
    >>> line.cells[0]
    Cell(text='3.78', best=True)
    """
    if name not in TABLES:
        raise unknown_name("table", name, TABLES)
    if name == "cost":
        return cost_table(results, costs or {}, run_costs)
    metric = "rcre" if name == "gopro-rcre" else name
    # The paper's two tables of RCRE: its benchmark without ground truth has one of its own.
    apart = [benchmark for benchmark in results["benchmark"].unique() if _published_without_flow(benchmark)]
    of_these = pl.col("benchmark").is_in(apart)
    chosen = results.filter(pl.col("metric") == metric, of_these if name == "gopro-rcre" else ~of_these)
    if chosen.is_empty():
        raise UsageError(f"the table '{name}' would be empty: these results have no such {METRIC_LABELS[metric]}")
    measured = set(chosen["corruption"])
    corruptions = [c for c in PAPER_ORDER if c in measured]
    keys = [CLEAN] * (CLEAN in measured) + corruptions + [AVERAGE]
    columns = [_column(key, metric) for key in keys]
    sections = []
    for setting in settings_in_order(chosen):
        lines = chosen.filter(setting=setting)
        sections.append(
            Section(SETTING_LABELS.get(setting, setting), _lines(lines, keys, marked=setting != "knowledge"))
        )
    title = f"{METRIC_LABELS[metric]} on {_listed(chosen['benchmark'])}"
    return Table(name, title, tuple(columns), tuple(sections), (_BEST,))


def _published_without_flow(benchmark: str) -> bool:
    facts = benchmark_facts(benchmark)
    return facts.published and not facts.has_flow


_BEST = "Best of each column among models of one setting measured on the same frames; lower is better."


def _listed(benchmarks: pl.Series) -> str:
    """What was measured on, in words, the paper's benchmark first."""
    listed = dict.fromkeys(benchmarks)
    names = [label for name, label in BENCHMARK_LABELS.items() if name in listed]
    names += sorted(plain(name) for name in listed if name not in BENCHMARK_LABELS)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def settings_in_order(results: pl.DataFrame) -> list[str]:
    """The settings found, the paper's first."""
    settings = list(dict.fromkeys(results["setting"]))
    return [name for name in SETTING_LABELS if name in settings] + sorted(set(settings) - set(SETTING_LABELS))


def _column(key: str, metric: str) -> Column:
    if key == CLEAN:
        return Column("Clean")
    if key == AVERAGE:
        return Column(f"AVG {METRIC_LABELS[metric]}")
    return Column(short_label(key), FAMILY_LABELS[FAMILY_OF[key]])


def _lines(results: pl.DataFrame, keys: list[str], marked: bool) -> tuple[Line, ...]:
    lines: dict[tuple[str, str], tuple[str, dict[str, str]]] = {}
    for row in results.iter_rows(named=True):
        _, cells = lines.setdefault((row["sample_set"], row["model"]), (row["note"], {}))
        cells[row["corruption"]] = number_text(row["value"], row["decimals"])
    # Two models are the best of a column together where the printed numbers are equal, as in the paper.
    best = {
        (frames, key): min(
            (float(c[key]) for (s, _), (_, c) in lines.items() if s == frames and key in c), default=None
        )
        for frames in {frames for frames, _ in lines}
        for key in keys
    }
    alone = {frames for frames, _ in lines if sum(other == frames for other, _ in lines) == 1}
    return tuple(
        Line(
            model,
            tuple(
                Cell(text := cells.get(key, "-"), marked and frames not in alone and _is(text, best[frames, key]))
                for key in keys
            ),
            note,
        )
        for (frames, model), (note, cells) in lines.items()
    )


def _is(text: str, best: float | None) -> bool:
    return text != "-" and float(text) == best
