"""The paper's Tab. 3: size, computing cost, relative robustness, and the ranks made from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import polars as pl

from ..analysis.published.tables import COUNTED_ITERATIONS, COUNTED_SIZE, PAPER, Cost
from ..analysis.ranking import average_ranks, competition_ranks
from ..analysis.results import AVERAGE, CLEAN
from ..errors import UsageError
from ..runs.costs import RunCost
from .table import Cell, Column, Line, Section, Table, number_text

_COLUMNS = (
    Column("Param. (M)"),
    Column("FLOPs (G)"),
    Column("OOD", "CREr & rank"),
    Column("ID", "CREr & rank"),
    Column("other", "CREr & rank"),
    Column("OOD", "Avg. rank"),
    Column("ID", "Avg. rank"),
    Column("other", "Avg. rank"),
)
_PLACE = {"OOD": (2, 5), "ID": (3, 6)}
_OTHER = (4, 7)
_Measured = tuple[str, str, str]
"""(sample set, setting, model)."""


@dataclass(frozen=True)
class RunRanks:
    """Ranks of a run, None where there is nothing to compare with: by CREr in its setting, by FLOPs among those counted
    at the same input size, and by both (see `ranking`)."""

    crer: int | None
    flops: int | None
    average: int | None


def cost_table(
    results: pl.DataFrame, costs: Mapping[str, Cost], run_costs: Mapping[tuple[str, str], RunCost] | None = None
) -> Table:
    """CREr beside cost, ranked by the rule of `ranking`.

    The models of `costs` come first with their CREr of both settings as printed; then models of `results` that were
    measured on other frames, each with the CREr of its setting, ranked among those measured on the same frames only:
    the published models never share a rank with them.

    Args:
        results: columns of `results.RESULT_SCHEMA`.
        costs: the published ones.
        run_costs: of runs, by (sample set, name).

    Raises:
        UsageError: neither costs nor a CREr.
    """
    sections = []
    if costs:
        sections.append(Section("Published", _published_lines(costs)))
    others = measured_crer(results.filter(pl.col("sample_set") != PAPER))
    if others:
        sections.append(Section("Measured on other frames", _measured_lines(others, run_costs or {})))
    if not sections:
        raise UsageError("nothing to put into the table 'cost': it needs the published costs, or runs with a CREr")
    shown = [index for index in range(len(_COLUMNS)) if others or index not in _OTHER]
    sections = [
        Section(s.title, tuple(Line(x.label, tuple(x.cells[i] for i in shown), x.note) for x in s.lines))
        for s in sections
    ]
    remarks = [
        "FLOPs are ranked over all models, CREr within its setting, equal values alike; lower is better. The average "
        "rank is that of their mean."
    ]
    if run_costs:
        remarks.append(
            f"FLOPs are multiply-accumulates as the paper counts them ({COUNTED_ITERATIONS} iterations, frames of "
            f"{COUNTED_SIZE[0]}x{COUNTED_SIZE[1]}, unless noted); "
            "runs are ranked among those on the same frames."
        )
    return Table(
        "cost",
        "Computing cost, CREr and average rank",
        tuple(_COLUMNS[i] for i in shown),
        tuple(sections),
        tuple(remarks),
    )


def cost_ranks(costs: Mapping[str, Cost]) -> dict[str, dict[str, int]]:
    """Ranks made from the values of `costs`: "flops", "crer_ood", "crer_id", "average_ood", "average_id" by model.

    >>> from robustflow.analysis.published.tables import published_costs
    >>> cost_ranks(published_costs())["average_id"]["CSFlow"]
    4
    """
    ranks = {"flops": competition_ranks({name: cost.flops_g for name, cost in costs.items()})}
    for setting in ("ood", "id"):
        known = {name: getattr(cost, f"crer_{setting}") for name, cost in costs.items()}
        ranks[f"crer_{setting}"] = competition_ranks(
            {name: value for name, value in known.items() if value is not None}
        )
        ranks[f"average_{setting}"] = average_ranks(ranks[f"crer_{setting}"], ranks["flops"])
    return ranks


def measured_crer(results: pl.DataFrame) -> dict[_Measured, tuple[float, str]]:
    """(sample set, setting, model) -> (CREr, note): as given, or made from the average and the clean EPE."""
    found: dict[tuple[str, str, str], dict[tuple[str, str], float]] = {}
    notes = {}
    for row in results.iter_rows(named=True):
        key = (row["sample_set"], row["setting"], row["model"])
        found.setdefault(key, {})[row["metric"], row["corruption"]] = row["value"]
        notes[key] = row["note"]
    out = {}
    for key, values in found.items():
        given, clean, epe = (values.get(k) for k in (("crer", AVERAGE), ("epe", CLEAN), ("epe", AVERAGE)))
        if given is None and epe is not None and clean:
            given = (epe - clean) / clean
        if given is not None:
            out[key] = (given, notes[key])
    return out


def _published_lines(costs: Mapping[str, Cost]) -> tuple[Line, ...]:
    ranks = cost_ranks(costs)
    lines = []
    for name, cost in costs.items():
        crer = [
            Cell("-" if value is None else f"{value:.2f} ({ranks[key][name]})")
            for key, value in (("crer_ood", cost.crer_ood), ("crer_id", cost.crer_id))
        ]
        average = [
            Cell(str(ranks[key].get(name, "-")), ranks[key].get(name) == 1) for key in ("average_ood", "average_id")
        ]
        size = Cell(f"{cost.parameters_m:.2f}"), Cell(f"{cost.flops_g:.1f} ({ranks['flops'][name]})")
        lines.append(Line(name, (*size, *crer, Cell("-"), *average, Cell("-"))))
    return tuple(lines)


def run_ranks(
    found: Mapping[_Measured, tuple[float, str]], run_costs: Mapping[tuple[str, str], RunCost]
) -> dict[_Measured, RunRanks]:
    """Ranks of models measured elsewhere than in the paper, among those of their setting on the same frames.

    Args:
        found: what `measured_crer` gives.
        run_costs: of runs, by (sample set, name).
    """
    known = {key: run_costs[key[0], key[2]] for key in found if (key[0], key[2]) in run_costs}
    ranks = {}
    for key in found:
        crer = _ranks({k: round(value, 2) for k, (value, _) in found.items() if k[:2] == key[:2]})
        flops = _ranks(
            {
                k: round(other.flops_g, 1)
                for k, other in known.items()
                if key in known and k[0] == key[0] and _counted(other) == _counted(known[key])
            }
        )
        average = average_ranks(crer, flops)
        ranks[key] = RunRanks(crer.get(key), flops.get(key), average.get(key) if len(average) > 1 else None)
    return ranks


def _measured_lines(
    found: Mapping[_Measured, tuple[float, str]], run_costs: Mapping[tuple[str, str], RunCost]
) -> tuple[Line, ...]:
    ranks, lines = run_ranks(found, run_costs), []
    for key, (value, note) in found.items():
        frames, setting, model = key
        rank, cost = ranks[key], run_costs.get((frames, model))
        cells = [Cell("-")] * len(_COLUMNS)
        crer_at, average_at = _PLACE.get(setting, _OTHER)
        cells[crer_at] = Cell(number_text(value, None) + _shown(rank.crer), rank.crer == 1)
        if cost is not None:
            cells[0] = Cell(f"{cost.parameters_m:.2f}")
            cells[1] = Cell(f"{cost.flops_g:.1f}{_shown(rank.flops)}")
            if rank.average is not None:
                cells[average_at] = Cell(str(rank.average), rank.average == 1)
            note = "; ".join(part for part in (note, _counted_note(cost)) if part)
        lines.append(Line(model, tuple(cells), note))
    return tuple(lines)


def _ranks(values: Mapping[_Measured, float]) -> dict[_Measured, int]:
    """Ranks, none for a model that is alone."""
    return competition_ranks(values) if len(values) > 1 else {}


def _shown(rank: int | None) -> str:
    return "" if rank is None else f" ({rank})"


def _counted(cost: RunCost) -> tuple[int, int]:
    return cost.height, cost.width


def _counted_note(cost: RunCost) -> str:
    told = [f"{cost.iterations} iterations"] if cost.iterations not in (None, COUNTED_ITERATIONS) else []
    if _counted(cost) != COUNTED_SIZE:
        told.append(f"frames of {cost.height}x{cost.width}")
    return f"FLOPs of {', '.join(told)}" if told else ""
