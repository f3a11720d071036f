"""The paper's Tab. 3: size, computing cost, relative robustness, and the ranks made from them."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from ..errors import UsageError
from .published import Cost
from .ranking import average_ranks, competition_ranks
from .results import AVERAGE, CLEAN
from .table import Cell, Column, Line, Section, Table, number_text

_COLUMNS = (
    Column("Param. (M)"),
    Column("FLOPs (G)"),
    Column("OOD", "CREr & rank"),
    Column("ID", "CREr & rank"),
    Column("other", "CREr & rank"),
    Column("OOD", "Avg. rank"),
    Column("ID", "Avg. rank"),
)


def cost_table(results: pl.DataFrame, costs: Mapping[str, Cost]) -> Table:
    """CREr beside cost, ranked by the rule of `ranking`.

    The models of `costs` come first with their CREr of both settings as printed; then models of `results` that were
    measured on other frames, each with the CREr of its setting, ranked among those measured on the same frames only.

    Raises:
        UsageError: neither costs nor a CREr.
    """
    sections = []
    if costs:
        sections.append(Section("Published", _published_lines(costs)))
    others = measured_crer(results.filter(pl.col("sample_set") != "paper"))
    if others:
        sections.append(Section("Measured on other frames", _measured_lines(others)))
    if not sections:
        raise UsageError("nothing to put into the table 'cost': it needs the published costs, or runs with a CREr")
    columns = _COLUMNS if others else _COLUMNS[:4] + _COLUMNS[5:]
    if not others:
        sections = [Section(s.title, tuple(_without_other(line) for line in s.lines)) for s in sections]
    remark = "FLOPs are ranked over all models, CREr within its setting, equal values alike; lower is better."
    return Table("cost", "Computing cost, CREr and average rank", columns, tuple(sections), (remark,))


def cost_ranks(costs: Mapping[str, Cost]) -> dict[str, dict[str, int]]:
    """Ranks made from the values of `costs`: "flops", "crer_ood", "crer_id", "average_ood", "average_id" by model.

    >>> from robustflow.report.published import published_costs
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


def measured_crer(results: pl.DataFrame) -> dict[tuple[str, str, str], tuple[float, str]]:
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
        lines.append(Line(name, (*size, *crer, Cell("-"), *average)))
    return tuple(lines)


def _measured_lines(found: Mapping[tuple[str, str, str], tuple[float, str]]) -> tuple[Line, ...]:
    lines = []
    for (frames, setting, model), (value, note) in found.items():
        peers = {m: round(v, 2) for (f, s, m), (v, _) in found.items() if (f, s) == (frames, setting)}
        rank = f" ({competition_ranks(peers)[model]})" if len(peers) > 1 else ""
        place = {"OOD": 2, "ID": 3}.get(setting, 4)
        cells = [Cell("-")] * len(_COLUMNS)
        cells[place] = Cell(number_text(value, None) + rank, len(peers) > 1 and peers[model] == min(peers.values()))
        lines.append(Line(model, tuple(cells), note))
    return tuple(lines)


def _without_other(line: Line) -> Line:
    return Line(line.label, line.cells[:4] + line.cells[5:], line.note)
