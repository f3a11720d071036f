"""The paper's tables from any results: published values, runs, or both.

A renderer (`robustflow.report.render`) writes what `build_table` makes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import polars as pl

from ..analysis.best import Compared, best_of_columns
from ..analysis.conditions import SeedGroup
from ..analysis.labels import (
    METRIC_LABELS,
    SETTING_LABELS,
    benchmark_words,
    family_label,
    short_label,
)
from ..analysis.published.tables import Cost
from ..analysis.results import AVERAGE, CLEAN
from ..benchmarks import benchmark_facts
from ..corruptions.names import ordered
from ..errors import UsageError, unknown_name
from ..runs.costs import RunCost
from ..text import joined
from .cost_table import cost_table
from .table import Column, Line, Section, Table, TableCell, number_text, spread_text, with_doubt

TABLES = ("epe", "cre", "rcre", "gopro-rcre", "cost")


def build_table(
    name: str,
    results: pl.DataFrame,
    costs: Mapping[str, Cost] | None = None,
    run_costs: Mapping[tuple[str, str], RunCost] | None = None,
    doubted: Mapping[tuple[str, str], str] | None = None,
    coverage: Mapping[tuple[str, str], float] | None = None,
    seeds: Sequence[SeedGroup] = (),
) -> Table:
    """One of the paper's tables, from any results.

    Args:
        name: "epe" (Tab. 2), "cre" (Tab. 7), "rcre" (Tab. 8), "gopro-rcre" (Tab. 4) or "cost" (Tab. 3).
        results: columns of `results.RESULT_SCHEMA`: published, of runs, or both after one another.
        costs: published ones by model, for "cost".
        run_costs: of runs by (sample set, name), for "cost"; runs that are not in it are listed without.
        doubted: by (sample set, name) of a run, why its model is not ranked; a footnote says so.
        coverage: by (sample set, name) of a run, the share of the pixels that its model predicted, if it left out any;
            shown in a separate column.
        seeds: groups of runs whose mean and standard deviation get a line below the last of them.

    Raises:
        UsageError: an unknown table, or results without anything that belongs in it.

    >>> from robustflow.analysis.published.tables import published_results
    >>> table = build_table("epe", published_results())
    >>> [section.title for section in table.sections]
    ['Knowledge-driven', 'Out-of-domain (OOD)', 'In-domain (ID)']
    >>> line = next(line for line in table.sections[1].lines if line.label == "SAMFlow-H")
    >>> line.cells[0]
    TableCell(text='3.78', best=True)
    """
    if name not in TABLES:
        raise unknown_name("table", name, TABLES)
    if name == "cost":
        return cost_table(results, costs or {}, run_costs, doubted)
    metric = "rcre" if name == "gopro-rcre" else name
    # The paper has two tables of RCRE: its benchmark without ground truth has a separate one.
    apart = [benchmark for benchmark in results["benchmark"].unique() if _published_without_flow(benchmark)]
    of_these = pl.col("benchmark").is_in(apart)
    chosen = results.filter(pl.col("metric") == metric, of_these if name == "gopro-rcre" else ~of_these)
    if chosen.is_empty():
        raise UsageError(f"the table '{name}' would be empty: these results have no such {METRIC_LABELS[metric]}")
    measured = set(chosen["corruption"])
    keys = [CLEAN] * (CLEAN in measured) + ordered(measured - {CLEAN, AVERAGE}) + [AVERAGE]
    columns = [_column(key, metric) for key in keys]
    models = set(chosen.select("sample_set", "model").iter_rows())
    gaps = {model: share for model, share in (coverage or {}).items() if model in models and share < 1}
    if gaps:
        keys.append(_COVERAGE)
        columns.append(Column("Coverage"))
    sections = []
    for setting in settings_in_order(chosen):
        lines = chosen.filter(setting=setting)
        sections.append(
            Section(
                SETTING_LABELS.get(setting, setting),
                _lines(lines, keys, setting != "knowledge", doubted or {}, gaps, seeds),
            )
        )
    title = f"{METRIC_LABELS[metric]} on {_measured_on(chosen['benchmark'])}"
    return Table(name, title, tuple(columns), tuple(sections), (_BEST, _SHARE) if gaps else (_BEST,))


def _published_without_flow(benchmark: str) -> bool:
    facts = benchmark_facts(benchmark)
    return facts.published and not facts.has_flow


_BEST = "Best of each column among models of one setting measured on the same frames; lower is better."


_COVERAGE = "coverage"
_SHARE = "Coverage: share of the pixels with ground truth that the model predicted; its errors are over these only."


def _measured_on(benchmarks: pl.Series) -> str:
    """What was measured on, in words, the paper's benchmark first."""
    unique = dict.fromkeys(benchmarks)
    facts = {name: benchmark_facts(name) for name in unique}
    order = sorted(unique, key=lambda name: (not facts[name].published, not facts[name].has_flow, name))
    return joined(list(map(benchmark_words, order)))


def settings_in_order(results: pl.DataFrame) -> list[str]:
    """The settings in the results, the paper's first."""
    settings = list(dict.fromkeys(results["setting"]))
    return [name for name in SETTING_LABELS if name in settings] + sorted(set(settings) - set(SETTING_LABELS))


def _column(key: str, metric: str) -> Column:
    if key == CLEAN:
        return Column("Clean")
    if key == AVERAGE:
        return Column(f"AVG {METRIC_LABELS[metric]}")
    return Column(short_label(key), family_label(key) or "Others")


def _lines(
    results: pl.DataFrame,
    keys: list[str],
    marked: bool,
    doubted: Mapping[tuple[str, str], str],
    gaps: Mapping[tuple[str, str], float],
    seeds: Sequence[SeedGroup],
) -> tuple[Line, ...]:
    lines: dict[tuple[str, str], tuple[str, dict[str, str]]] = {}
    values: dict[tuple[str, str], dict[str, float]] = {}
    for row in results.iter_rows(named=True):
        _, cells = lines.setdefault((row["sample_set"], row["model"]), (row["note"], {}))
        cells[row["corruption"]] = number_text(row["value"], row["decimals"])
        values.setdefault((row["sample_set"], row["model"]), {})[row["corruption"]] = row["value"]
    best = best_of_columns(
        [Compared(key[0], texts if marked else {}, key in doubted) for key, (_, texts) in lines.items()]
    )
    out = []
    for (key, (note, texts)), columns in zip(lines.items(), best, strict=True):
        shown = texts | ({_COVERAGE: number_text(gaps[key], None)} if key in gaps else {})
        line = tuple(TableCell(shown.get(column, "-"), column in columns) for column in keys)
        out.append(Line(key[1], line, with_doubt(note, doubted.get(key))))
        out += [_over_seeds(group, values, keys, doubted) for group in seeds if key == group.runs[-1]]
    return tuple(out)


def _over_seeds(
    group: SeedGroup,
    values: Mapping[tuple[str, str], Mapping[str, float]],
    keys: list[str],
    doubted: Mapping[tuple[str, str], str],
) -> Line:
    cells = tuple(TableCell(spread_text([values[run].get(key) for run in group.runs])) for key in keys)
    return Line(group.label, cells, with_doubt(group.note, doubted.get(group.runs[0])))
