"""The paper's tables, made from published values, runs, or both: the metrics by corruption, and cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from ..core.errors import UsageError, unknown_name
from ..core.text import joined
from ..corruptions.registry import MEMBERS, ordered
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import is_still
from ..run.costs import COUNTED_SIZE, RunCost
from ..stats.exclusion import PHANTOM
from ..stats.model_result import CRER, FLOPS, PARAMETERS, RANKS, ModelResult, Value, ValueKey
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
from ..stats.seeds import SeedGroup
from .leaderboard import marked_cells
from .table import Column, Row, Table, TableCell, Wanted, full_note, seed_row, with_exclusion

PAPER_TABLES = {"epe": "epe", "cre": "cre", "rcre": "rcre", "gopro-rcre": "rcre"}
"""The tables of a metric by corruption, with the metric. Two are of RCRE: one for benchmarks without ground truth."""

_BEST = "Bold: lowest value among learned models in the same setting on the same frames."
_SHARE = "Coverage: share of the pixels with ground truth that the model predicted; its errors are over these pixels."


def _of_metric(name: str, wanted: Wanted) -> list[Table]:
    return [build_table(name, wanted.results, wanted.seeds)]


epe, cre, rcre, gopro_rcre = (partial(_of_metric, name) for name in PAPER_TABLES)
"""The paper's Tab. 2, 7, 8 and 4."""


def cost(wanted: Wanted) -> list[Table]:
    """Return the paper's Tab. 3."""
    return [cost_table(wanted.results)]


def build_table(name: str, results: Sequence[ModelResult], seeds: Sequence[SeedGroup] = ()) -> Table:
    """Build one of `PAPER_TABLES` from any results: a line per model, a column per corruption, a section per
    setting, both in the order of the results."""
    if name not in PAPER_TABLES:
        raise unknown_name("table", name, PAPER_TABLES)
    metric = PAPER_TABLES[name]
    on_it = [one for one in results if _published_without_flow(one.benchmark) == (name == "gopro-rcre")]
    cells = {
        line: {of: cell for (m, of), cell in of_line.items() if m == metric}
        for line, of_line in marked_cells(on_it).items()
    }
    chosen = {line: of_line for line, of_line in cells.items() if of_line}
    if not chosen:
        raise UsageError("--table", f"'{name}' would be empty: these results do not have a {LABELS[metric]}")
    measured = {condition for of_line in chosen.values() for condition in of_line}
    keys = [CLEAN] * (CLEAN in measured) + ordered(measured - {CLEAN, AVERAGE, *MEMBERS}) + [AVERAGE]
    gaps = any((line.coverage or 1) < 1 for line in chosen)
    sections: dict[str, list[Row]] = {}
    for setting in dict.fromkeys(line.setting for line in chosen):
        here = [line for line in chosen if line.setting == setting]
        numbers = {line.key: [*(line.number(metric, of) for of in keys), *[None] * gaps] for line in here}
        rows = sections.setdefault(SETTING_LABELS.get(setting, setting), [])
        for line in here:
            shown = [*map(chosen[line].get, keys), *[line.coverage] * gaps]
            rows.append(Row(line.name, shown, with_exclusion(line.note, line.excluded), result=line))
            for group in (group for group in seeds if group.runs[-1] == line.key and numbers.keys() >= {*group.runs}):
                excluded = next(one.excluded for one in here if one.key == group.runs[0])
                rows.append(seed_row(group, numbers, excluded))
    title = f"{LABELS[metric]} on {_measured_on(line.benchmark for line in chosen)}"
    still = any(is_still(line.benchmark) for line in chosen)
    marked = any(cell.best for of_line in chosen.values() for cell in of_line.values())
    remarks = [_BEST] * marked + [_SHARE] * gaps + [PHANTOM] * still
    columns = [*(_column(key, metric) for key in keys), *[Column("Coverage")] * gaps]
    return Table.of(name, title, columns, sections, remarks, keep_empty=True)


def _column(key: str, metric: str) -> Column:
    if key in (CLEAN, AVERAGE):
        return Column("Clean" if key == CLEAN else f"AVG {LABELS[metric]}")
    return Column(short_label(key), group=family_label(key) or "Others")


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


def cost_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate size, computing cost, CREr, and the ranks derived from them."""
    printed, others = _published_costs(results), [line for line in results if line.frames != PAPER]
    measured = [_cost_row(line) for line in others if CRER in line.values]
    if not printed and not measured:
        raise UsageError("--table", "'cost' would be empty: it needs the published costs, or runs with a CREr")
    remarks = [
        "Published MACs are ranked over all models, CREr within its setting; lower is better, equal values share a "
        "rank. The average rank is the rank of the mean of both."
    ] * bool(printed)
    if any(FLOPS in line.values for line in others):
        remarks.append(
            f"MACs are counted as thop does, as the FLOPs of the paper are ({COUNTED_ITERATIONS} iterations, frames of "
            f"{COUNTED_SIZE[0]}x{COUNTED_SIZE[1]}, unless noted)."
        )
    rows = {"Published": printed, "Measured on different frames": measured}
    return Table.of("cost", "Computing cost, CREr and average rank", _COST_COLUMNS, rows, remarks)


def _published_costs(results: Sequence[ModelResult]) -> list[Row]:
    rows = []
    for name in published_costs():
        printed = [line for line in results if line.name == name and RANKS["flops"] in line.values]
        of_setting = {line.setting: line.values for line in printed}
        if not of_setting:
            continue
        model = next(iter(of_setting.values()))
        texts: list[str | None] = [model[PARAMETERS].text, _with_rank(model, FLOPS, RANKS["flops"])]
        texts += [_with_rank(of_setting.get(setting, {}), CRER, RANKS["crer"]) for setting in ("OOD", "ID")]
        ranks = [of_setting.get(setting, {}).get(RANKS["average"]) for setting in ("OOD", "ID")]
        cells = [TableCell(rank.text, rank.number == 1) if rank else None for rank in ranks]
        first = any(cell and cell.best for cell in cells)
        rows.append(Row(name, [*texts, None, *cells], best=first, result=printed[0]))
    return rows


def _with_rank(values: Mapping[ValueKey, Value], key: ValueKey, rank: ValueKey) -> str | None:
    return f"{values[key].text} ({values[rank].text})" if rank in values else None


def _cost_row(result: ModelResult) -> Row:
    texts: list[str | None] = [None] * len(_COST_COLUMNS)
    notes = [full_note(result)]
    texts[{"OOD": 2, "ID": 3}.get(result.setting, 4)] = result.values[CRER].text
    if result.run is not None and (found := RunCost.read(result.run)) is not None:
        texts[:2] = result.values[PARAMETERS].text, result.values[FLOPS].text
        notes.append(_counted_note(found))
    return Row(result.name, texts, "; ".join(filter(None, notes)), result=result)


def _counted_note(found: RunCost) -> str:
    conditions = [f"{found.iterations} iterations"] if found.iterations not in (None, COUNTED_ITERATIONS) else []
    if (found.height, found.width) != COUNTED_SIZE:
        conditions.append(f"frames of {found.height}x{found.width}")
    return f"MACs of {', '.join(conditions)}" if conditions else ""
