"""The paper's tables, made from published values, runs, or both: the metrics by corruption, and cost."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from ..core.errors import UsageError, unknown_name
from ..core.text import joined
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import is_still
from ..metrics.cube import MeanKey
from ..run.costs import COUNTED_SIZE
from ..stats.exclusion import PHANTOM
from ..stats.lines import CRER, FLOPS, PARAMETERS, RANKS, LineKey, Lines, Numbers, number_of
from ..stats.published.tables import COUNTED_ITERATIONS, PAPER, published_costs
from ..stats.results import (
    AVERAGE,
    CLEAN,
    LABELS,
    SETTING_LABELS,
    benchmark_words,
    family_label,
    short_label,
)
from .leaderboard import marked_cells
from .table import Column, Row, Table, TableCell, Wanted, cell_of, full_note, with_exclusion, without_seeds

PAPER_TABLES = {"epe": "epe", "cre": "cre", "rcre": "rcre", "gopro-rcre": "rcre"}
"""The tables of a metric by corruption, with the metric. Two are of RCRE: one for benchmarks without ground truth."""

_BEST = "Bold: lowest value among learned models in the same setting on the same frames."
_SHARE = "Coverage: share of the pixels with ground truth that the model predicted; its errors are over these pixels."


def _of_metric(name: str, wanted: Wanted) -> list[Table]:
    return [build_table(name, wanted.lines)]


epe, cre, rcre, gopro_rcre = (partial(_of_metric, name) for name in PAPER_TABLES)
"""The paper's Tab. 2, 7, 8 and 4."""


def cost(wanted: Wanted) -> list[Table]:
    """Return the paper's Tab. 3."""
    return [cost_table(without_seeds(wanted.lines))]


def build_table(name: str, lines: Lines) -> Table:
    """Build one of `PAPER_TABLES` from any results: a line per model, a column per corruption, a section per
    setting, both in the order of the results."""
    if name not in PAPER_TABLES:
        raise unknown_name("table", name, PAPER_TABLES)
    metric = PAPER_TABLES[name]
    on_it = {
        key: numbers
        for key, numbers in lines.items()
        if _published_without_flow(key.benchmark) == (name == "gopro-rcre")
        and (numbers.by_corruption(metric) or any((metric, of, None) in numbers for of in (CLEAN, AVERAGE)))
    }
    if not on_it:
        raise UsageError("--table", f"'{name}' would be empty: these results do not have a {LABELS[metric]}")
    corruptions = Numbers(item for numbers in on_it.values() for item in numbers.items()).corruptions((metric,))
    clean = metric == "epe" and any((metric, CLEAN, None) in numbers for numbers in on_it.values())
    columns = [_column(of, metric) for of in (*[CLEAN] * clean, *corruptions, AVERAGE)]
    gaps = any((numbers.coverage or 1) < 1 for numbers in on_it.values())
    sections: dict[str, list[Row]] = {}
    marked = marked_cells(on_it)
    for key, numbers in on_it.items():
        values = [*(marked[key].get(column.key) for column in columns), *[numbers.coverage] * gaps]
        note = with_exclusion(numbers.fact("note"), numbers.fact("excluded"))
        title = SETTING_LABELS.get(key.setting, key.setting)
        sections.setdefault(title, []).append(Row(key.model, values, note, result=key))
    title = f"{LABELS[metric]} on {_measured_on(key.benchmark for key in on_it)}"
    still = any(is_still(key.benchmark) for key in on_it)
    best = any(cell.best for cells in marked.values() for of, cell in cells.items() if of[0] == metric)
    remarks = [_BEST] * best + [_SHARE] * gaps + [PHANTOM] * still
    return Table.of(name, title, [*columns, *[Column("Coverage")] * gaps], sections, remarks, keep_empty=True)


def _column(of: str, metric: str) -> Column:
    key = (metric, of, None)
    if of in (CLEAN, AVERAGE):
        return Column("Clean" if of == CLEAN else f"AVG {LABELS[metric]}", key=key)
    return Column(short_label(of), group=family_label(of) or "Others", key=key)


def _published_without_flow(benchmark: str) -> bool:
    facts = benchmark_facts(benchmark)
    return facts.published and not facts.has_flow


def _measured_on(benchmarks: Iterable[str]) -> str:
    """Return the names of the results' benchmarks as text, with the paper's benchmarks first."""
    facts = {name: benchmark_facts(name) for name in benchmarks}
    order = sorted(facts, key=lambda name: (not facts[name].published, not facts[name].has_flow, name))
    return joined(list(map(benchmark_words, order)))


_COST_COLUMNS = (
    Column("Param. (M)"),
    Column("MACs (G)"),
    *(Column(setting, group="CREr & rank") for setting in ("OOD", "ID", "other")),
    *(Column(setting, group="Avg. rank") for setting in ("OOD", "ID")),
)


def cost_table(lines: Lines) -> Table:
    """Tabulate size, computing cost, CREr, and the ranks derived from them."""
    others = {key: numbers for key, numbers in lines.items() if key.sample_set != PAPER}
    printed = _published_costs(lines)
    measured = [_cost_row(key, numbers) for key, numbers in others.items() if CRER in numbers]
    if not printed and not measured:
        raise UsageError("--table", "'cost' would be empty: it needs the published costs, or runs with a CREr")
    remarks = [
        "Published MACs are ranked over all models, CREr within its setting; lower is better, equal values share a "
        "rank. The average rank is the rank of the mean of both."
    ] * bool(printed)
    if any(FLOPS in numbers for numbers in others.values()):
        remarks.append(
            f"MACs are counted as thop does, as the FLOPs of the paper are ({COUNTED_ITERATIONS} iterations, frames of "
            f"{COUNTED_SIZE[0]}x{COUNTED_SIZE[1]}, unless noted)."
        )
    rows = {"Published": printed, "Measured on different frames": measured}
    return Table.of("cost", "Computing cost, CREr and average rank", _COST_COLUMNS, rows, remarks)


def _published_costs(lines: Lines) -> list[Row]:
    rows = []
    for name in published_costs():
        printed = {key: numbers for key, numbers in lines.items() if key.model == name and RANKS["flops"] in numbers}
        of_setting = {key.setting: numbers for key, numbers in printed.items()}
        if not of_setting:
            continue
        key, model = next(iter(printed.items()))
        texts: list[str | None] = [number_of(model[PARAMETERS]), _with_rank(model, FLOPS, RANKS["flops"])]
        texts += [_with_rank(of_setting.get(setting, Numbers()), CRER, RANKS["crer"]) for setting in ("OOD", "ID")]
        ranks = [of_setting.get(setting, Numbers()).get(RANKS["average"]) for setting in ("OOD", "ID")]
        cells = [TableCell(number_of(rank), rank["value"] == 1) if rank else None for rank in ranks]
        first = any(cell and cell.best for cell in cells)
        rows.append(Row(name, [*texts, None, *cells], best=first, result=key))
    return rows


def _with_rank(numbers: Numbers, key: MeanKey, rank: MeanKey) -> str | None:
    return f"{number_of(numbers[key])} ({number_of(numbers[rank])})" if rank in numbers else None


def _cost_row(key: LineKey, numbers: Numbers) -> Row:
    cells: list[TableCell | None] = [None] * len(_COST_COLUMNS)
    cells[{"OOD": 2, "ID": 3}.get(key.setting, 4)] = TableCell(number_of(numbers[CRER]))
    for place, of in enumerate((PARAMETERS, FLOPS)):
        cells[place] = cell_of(numbers[of]) if of in numbers else None
    note = "; ".join(filter(None, (full_note(numbers), _counted_note(numbers))))
    return Row(key.model, cells, note, result=key)


def _counted_note(numbers: Numbers) -> str:
    iterations, height, width = (numbers.number(f"counted_{name}", "") for name in ("iterations", "height", "width"))
    conditions = [f"{iterations:g} iterations"] if iterations not in (None, COUNTED_ITERATIONS) else []
    if height is not None and (height, width) != COUNTED_SIZE:
        conditions.append(f"frames of {height:g}x{width:g}")
    return f"MACs of {', '.join(conditions)}" if conditions else ""
