"""The paper's tables, made from published values, runs, or both. Terminal tables of finished runs: means by
corruption, a single metric, and overall means of several runs.

Use `robustflow.report.render` to write a table as text.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from ..core.errors import UsageError, unknown_name
from ..core.text import joined
from ..corruptions.registry import ordered
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import is_still
from ..metrics.measures import UNCOUPLED
from ..stats.conditions import SeedGroup
from ..stats.exclusion import PHANTOM
from ..stats.frame import uncoupled_means
from ..stats.model_result import ModelResult, Value
from ..stats.ranking import Compared, best_of_columns
from ..stats.results import (
    AVERAGE,
    CLEAN,
    METRIC_LABELS,
    RESULT_METRICS,
    SETTING_LABELS,
    benchmark_words,
    family_label,
    metric_label,
    short_label,
)
from .cost_table import cost_table
from .table import Column, Line, Section, Table, TableCell, full_note, number_text, seed_line, with_exclusion

if TYPE_CHECKING:
    from ..run.run import Run

TABLES = ("epe", "cre", "rcre", "gopro-rcre", "cost")

_BEST = (
    "Marked values are the best in their column among models in the same setting measured on the same frames; lower is "
    "better."
)
_COVERAGE = "coverage"
_SHARE = (
    "Coverage: share of the pixels with ground truth that the model predicted; its errors are computed over these "
    "pixels only."
)


def build_table(
    name: str,
    results: Sequence[ModelResult],
    seeds: Sequence[SeedGroup] = (),
) -> Table:
    """Build one of the paper's tables from any results."""
    if name not in TABLES:
        raise unknown_name("table", name, TABLES)
    if name == "cost":
        return cost_table(results)
    metric = "rcre" if name == "gopro-rcre" else name
    # The paper has two RCRE tables, one of them for the benchmark without ground truth.
    chosen = {
        line: values
        for line in results
        if _published_without_flow(line.benchmark) == (name == "gopro-rcre")
        and (values := {of: value for (kind, of), value in line.values.items() if kind == metric})
    }
    if not chosen:
        raise UsageError(f"the table '{name}' would be empty: these results do not have a {METRIC_LABELS[metric]}")
    measured = {condition for values in chosen.values() for condition in values}
    keys = [CLEAN] * (CLEAN in measured) + ordered(measured - {CLEAN, AVERAGE}) + [AVERAGE]
    columns = [_column(key, metric) for key in keys]
    gaps = any((line.coverage or 1) < 1 for line in chosen)
    if gaps:
        keys.append(_COVERAGE)
        columns.append(Column("Coverage"))
    sections = tuple(
        Section(
            SETTING_LABELS.get(setting, setting),
            _lines({line: values for line, values in chosen.items() if line.setting == setting}, metric, keys, seeds),
        )
        for setting in settings_in_order(line.setting for line in chosen)
    )
    title = f"{METRIC_LABELS[metric]} on {_measured_on(line.benchmark for line in chosen)}"
    marked = any(cell.best for section in sections for line in section.lines for cell in line.cells)
    remarks = [_BEST] * marked + [_SHARE] * gaps
    if any(is_still(line.benchmark) for line in chosen):
        remarks.append(PHANTOM)
    return Table(name, title, tuple(columns), sections, tuple(remarks))


def _published_without_flow(benchmark: str) -> bool:
    facts = benchmark_facts(benchmark)
    return facts.published and not facts.has_flow


def _measured_on(benchmarks: Iterable[str]) -> str:
    """Return the names of the results' benchmarks as text, with the paper's benchmarks first."""
    unique = dict.fromkeys(benchmarks)
    facts = {name: benchmark_facts(name) for name in unique}
    order = sorted(unique, key=lambda name: (not facts[name].published, not facts[name].has_flow, name))
    return joined(list(map(benchmark_words, order)))


def settings_in_order(settings: Iterable[str]) -> list[str]:
    """Return the distinct settings, with the paper's settings first."""
    known = set(settings)
    return [name for name in SETTING_LABELS if name in known] + sorted(known - set(SETTING_LABELS))


def _column(key: str, metric: str) -> Column:
    if key == CLEAN:
        return Column("Clean")
    if key == AVERAGE:
        return Column(f"AVG {METRIC_LABELS[metric]}")
    return Column(short_label(key), family_label(key) or "Others")


def _lines(
    chosen: Mapping[ModelResult, Mapping[str, Value]], metric: str, keys: Sequence[str], seeds: Sequence[SeedGroup]
) -> tuple[Line, ...]:
    """Build the lines for one setting."""
    texts = {line: {of: value.text for of, value in values.items()} for line, values in chosen.items()}
    compared = [
        Compared(line.frames, shown if line.may_be_best(metric) else {}, bool(line.excluded))
        for line, shown in texts.items()
    ]
    excluded = {line.key: line.excluded for line in chosen}
    numbers = {
        line.key: [values[key].number if key in values else None for key in keys] for line, values in chosen.items()
    }
    out = []
    for (line, shown), best in zip(texts.items(), best_of_columns(compared), strict=True):
        shown |= {} if line.coverage is None else {_COVERAGE: number_text(line.coverage, None)}
        cells = tuple(TableCell(shown.get(key, "-"), key in best) for key in keys)
        out.append(Line(line.name, cells, with_exclusion(line.note, line.excluded)))
        for group in seeds:
            if line.key == group.runs[-1] and numbers.keys() >= set(group.runs):
                out.append(seed_line(group, numbers, excluded[group.runs[0]]))
    return tuple(out)


MEANS = {("epe", CLEAN): "clean EPE (px)"} | {(metric, AVERAGE): metric_label(metric) for metric in RESULT_METRICS}
"""The overall means in tables of runs, with their labels."""
_WITHOUT_TRUTH = ("clean flow (px)", "clean photometric error (grey levels)", "of zero flow")


def corruptions_table(run: Run, title: str) -> Table:
    """Tabulate the means of a run for each corruption, and its EPE (RCRE without ground truth) at each severity."""
    corruptions = run.measured.corruptions
    shown = [
        metric
        for metric in ("epe", "cre", "crer", "rcre")
        if any(run.mean(metric, name) is not None for name in corruptions)
    ]
    at_each, levels = "epe" if "epe" in shown else "rcre", run.measured.severities
    shown += ["photometric"] * (at_each == "rcre")
    shown += ["coverage"] * run.averages.has_gaps + ["spread"] * (run.mean("spread") is not None)
    columns = [Column(METRIC_LABELS.get(metric, metric)) for metric in shown]
    columns += [Column(f"{METRIC_LABELS[at_each]} {level}" if level == levels[0] else str(level)) for level in levels]
    lines = []
    for name in corruptions:
        means = (run.mean(metric, name) for metric in shown)
        lines.append(Line.of_numbers(name, (*means, *(run.mean(at_each, name, level) for level in levels))))
    texts = (number_text(run.mean(metric)) for metric in shown)
    sections = (*_by_family(lines), Section("All", (Line.of("mean", (*texts, *[""] * len(levels))),)))
    return Table("corruptions", title, tuple(columns), sections, row_header="Corruption")


def severities_table(run: Run, metric: str, title: str) -> Table:
    """Tabulate a metric of a run, or one of `UNCOUPLED`, by corruption and severity, with the mean over severities."""
    known = uncoupled_means(run.rows) if metric in UNCOUPLED else run.means
    levels: list[int | None] = [*run.measured.severities, None]
    lines = [
        Line.of_numbers(name, (known.get((metric, name, level)) for level in levels))
        for name in run.measured.corruptions
    ]
    columns = tuple(Column("mean" if level is None else str(level)) for level in levels)
    return Table("severities", title, columns, tuple(_by_family(lines)), row_header="Corruption")


def runs_table(results: Sequence[ModelResult], seeds: Sequence[SeedGroup] = ()) -> Table:
    """Tabulate the overall means of runs; without ground truth, also the mean length and the photometric error of the
    clean flow. For each group in `seeds`, a row with the mean and standard deviation follows the group's last run."""
    without_truth = all(line.number("epe", CLEAN) is None for line in results)
    lines, values = [], {}
    for line in results:
        run = line.run if without_truth else None
        clean = [run.mean(name, CLEAN) if run else None for name in ("flow_length", "photometric", "photometric_still")]
        values[line.key] = [*(line.number(*key) for key in MEANS), *clean]
        lines.append(Line.of_numbers(line.name, values[line.key], full_note(line)))
        lines += [seed_line(group, values) for group in seeds if group.runs[-1] == line.key]
    columns = map(Column, (*MEANS.values(), *_WITHOUT_TRUTH))
    table = Table("runs", "Means", tuple(columns), (Section("Runs", tuple(lines)),))
    return table.without_empty_columns()


def _by_family(lines: Iterable[Line]) -> Iterable[Section]:
    """Group the lines of corruptions, which are in the paper's order, by family."""
    for family, of_family in groupby(lines, lambda line: family_label(line.label) or "Others"):
        yield Section(family, tuple(of_family))
