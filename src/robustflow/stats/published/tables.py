"""The paper's published results: tables 1 to 4, 7 and 8 as data, with every value as printed.

Yi et al., "Benchmarking the Robustness of Optical Flow Estimation to Corruptions". Nothing is corrected here:
`robustflow reproduce audit` lists the inconsistencies in the tables.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Literal

import polars as pl

from ...core.types import Frozen
from ...metrics.cube import MeanKey
from ..frame import DERIVED, given_frame
from ..lines import CRER, FLOPS, PARAMETERS, RANKS, LineKey, Lines, lines_of
from ..ranking import average_ranks, competition_ranks
from ..results_file import parse_results

PAPER = "paper"
"""The sample set of the published values."""

_NOT_DISCUSSED = ("FlowDiffuser",)

COUNTED_ITERATIONS = 12
"""Number of iterations for which Tab. 3 states the cost of iterative models (Sec. 4.2)."""

_TABLES = ("kitti_fc_epe", "kitti_fc_cre", "kitti_fc_rcre", "gopro_fc_rcre")


class Method(Frozen):
    """A method as described in the paper (Tab. 1); the encoder or decoder is "" if the method has none."""

    method: str
    type: Literal["knowledge", "supervised", "unsupervised"]
    encoder: str
    decoder: str
    year: int
    source: str


@cache
def published_frame() -> pl.DataFrame:
    """Return the KITTI-FC EPE, CRE and RCRE of 29 variants and the GoPro-FC RCRE of 11, and the costs of Tab. 3, as a
    results frame."""
    tables = [parse_results(_text(table), f"{table}.csv", PAPER, "published") for table in _TABLES]
    epe = tables[0].unique(["setting", "model"], maintain_order=True)
    costs = [
        {name: line[name] for name in ("benchmark", "sample_set", "setting", "model", "source")}
        | {"measure": measure, "condition": condition, "origin": cost["source"]}
        | {"value": float(cost[column]), "decimals": len(cost[column].partition(".")[2])}
        for line in epe.iter_rows(named=True)
        if (cost := published_costs().get(line["model"])) is not None
        for (measure, condition, _), column in _cost_columns(line["setting"].lower()).items()
        if cost.get(column)
    ]
    return pl.concat([*tables, given_frame(costs)])


def _cost_columns(setting: str) -> dict[MeanKey, str]:
    """Return the columns of Tab. 3 about a model in a setting."""
    names = {"crer": f"crer_rank_{setting}", "average": f"average_rank_{setting}", "flops": "flops_rank"}
    return {PARAMETERS: "parameters_m", FLOPS: "flops_g", CRER: f"crer_{setting}"} | {
        RANKS[name]: column for name, column in names.items()
    }


@cache
def published_lines() -> Lines:
    """Return the lines of `published_frame`."""
    return lines_of(published_frame())


@cache
def published_costs() -> dict[str, dict[str, str]]:
    """Return Tab. 3 by model, in the paper's order."""
    return {line["model"]: line for line in csv.DictReader(_text("cost").splitlines())}


def cost_ranks(
    lines: Lines, crer: Mapping[tuple[str, str], float] | None = None
) -> dict[tuple[str, str], dict[str, int]]:
    """Rank the models of Tab. 3, in its order, by ("flops", setting), ("crer", setting) and ("average", setting); the
    FLOPs over the models of all settings. `crer` replaces the printed CREr of (setting, model)."""
    of_model = {(key.setting, key.model): numbers for key, numbers in lines.items() if RANKS["flops"] in numbers}
    flops = {name: v[FLOPS]["value"] for name in published_costs() for (_, of), v in of_model.items() if of == name}
    ranks: dict[tuple[str, str], dict[str, int]] = {}
    for setting in ("OOD", "ID"):
        printed = {name: of_model[setting, name][CRER] for name in flops if (setting, name) in of_model}
        given = {name: row["value"] for name, row in printed.items() if row["origin"] != DERIVED}
        known = {name: (crer or {}).get((setting, name), value) for name, value in given.items()}
        of_setting = {"flops": competition_ranks(flops), "crer": competition_ranks(known)}
        of_setting["average"] = average_ranks(of_setting["crer"], of_setting["flops"])
        ranks |= {(name, setting): values for name, values in of_setting.items()}
    return ranks


def not_discussed(lines: Iterable[LineKey]) -> tuple[str, ...]:
    """List the models that figures and observations omit: for the paper's results, the learned models that the
    paper omits from its discussion (Sec. 5.2); for all other results, none.
    """
    return _NOT_DISCUSSED if of_paper(lines) else ()


def of_paper(lines: Iterable[LineKey]) -> bool:
    """Whether the lines include published values."""
    return any(key.sample_set == PAPER for key in lines)


@cache
def published_methods() -> dict[str, Method]:
    """Return Tab. 1 by method, in the paper's order."""
    methods = (Method.model_validate(line) for line in csv.DictReader(_text("methods").splitlines()))
    return {method.method: method for method in methods}


def method_of(model: str) -> Method | None:
    """Return the method of a published variant (SAMFlow-T, -B and -H belong to SAMFlow); None for other models."""
    methods = published_methods()
    return methods.get(model) or methods.get(model.rpartition("-")[0])


def _text(table: str) -> str:
    return (files("robustflow.stats.published") / f"{table}.csv").read_text(encoding="utf-8")
