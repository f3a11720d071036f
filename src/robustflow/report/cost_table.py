"""The paper's Tab. 3: model size, computing cost, relative robustness, and the ranks derived from them."""

from __future__ import annotations

from collections.abc import Sequence

from ..core.errors import UsageError
from ..run.costs import COUNTED_SIZE, RunCost
from ..stats.model_result import ModelResult, printed_cost_ranks, printed_costs
from ..stats.published.tables import COUNTED_ITERATIONS, PAPER
from .table import Column, Line, Section, Table, TableCell, full_note, number_text

_COLUMNS = (
    Column("Param. (M)"),
    Column("FLOPs (G)"),
    Column("OOD", "CREr & rank"),
    Column("ID", "CREr & rank"),
    Column("other", "CREr & rank"),
    Column("OOD", "Avg. rank"),
    Column("ID", "Avg. rank"),
)
_PLACE = {"OOD": 2, "ID": 3}
_OTHER = 4


def cost_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate CREr and cost."""
    sections = []
    if printed := _published_lines(results):
        sections.append(Section("Published", printed))
    others = [line for line in results if line.frames != PAPER]
    if lines := _other_lines(others):
        sections.append(Section("Measured on different frames", lines))
    if not sections:
        raise UsageError("the table 'cost' would be empty: it needs the published costs, or runs with a CREr")
    remarks = [
        "Published FLOPs are ranked over all models, and CREr within its setting; equal values share a rank, and lower "
        "is better. The average rank is the rank of the mean of both ranks."
    ] * bool(printed)
    if any(line.cost for line in others):
        remarks.append(
            f"FLOPs are multiply-accumulates counted as in the paper ({COUNTED_ITERATIONS} iterations, frames of "
            f"{COUNTED_SIZE[0]}x{COUNTED_SIZE[1]}, unless noted)."
        )
    table = Table("cost", "Computing cost, CREr and average rank", _COLUMNS, tuple(sections), tuple(remarks))
    return table.without_empty_columns()


def _published_lines(results: Sequence[ModelResult]) -> tuple[Line, ...]:
    ranks = printed_cost_ranks(results)
    lines = []
    for name, cost in printed_costs(results).items():
        crer = [
            TableCell("-" if value is None else f"{value:.2f} ({ranks[key][name]})")
            for key, value in (("crer_ood", cost.crer_ood), ("crer_id", cost.crer_id))
        ]
        average = [
            TableCell(str(ranks[key].get(name, "-")), ranks[key].get(name) == 1)
            for key in ("average_ood", "average_id")
        ]
        size = TableCell(f"{cost.parameters_m:.2f}"), TableCell(f"{cost.flops_g:.1f} ({ranks['flops'][name]})")
        cells = (*size, *crer, TableCell("-"), *average)
        lines.append(Line(name, cells, best=any(cell.best for cell in average)))
    return tuple(lines)


def _other_lines(results: Sequence[ModelResult]) -> tuple[Line, ...]:
    lines = []
    for result in results:
        if result.crer is None:
            continue
        cost, note = result.cost, full_note(result)
        cells = [TableCell("-")] * len(_COLUMNS)
        cells[_PLACE.get(result.setting, _OTHER)] = TableCell(number_text(result.crer, None))
        if cost is not None:
            cells[0] = TableCell(f"{cost.parameters_m:.2f}")
            cells[1] = TableCell(f"{cost.flops_g:.1f}")
            note = "; ".join(part for part in (note, _counted_note(cost)) if part)
        lines.append(Line(result.name, tuple(cells), note))
    return tuple(lines)


def _counted_note(cost: RunCost) -> str:
    conditions = [f"{cost.iterations} iterations"] if cost.iterations not in (None, COUNTED_ITERATIONS) else []
    if (cost.height, cost.width) != COUNTED_SIZE:
        conditions.append(f"frames of {cost.height}x{cost.width}")
    return f"FLOPs of {', '.join(conditions)}" if conditions else ""
