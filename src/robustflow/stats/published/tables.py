"""The paper's published results: tables 1 to 4, 7 and 8 as data, with every value as printed.

Yi et al., "Benchmarking the Robustness of Optical Flow Estimation to Corruptions". Nothing is corrected here:
`robustflow reproduce audit` lists the inconsistencies in the tables.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Literal

from ...core.types import Frozen
from ...data.benchmarks import benchmark_facts
from ..model_result import ModelResult, PrintedCost, merged
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
def published_results() -> tuple[ModelResult, ...]:
    """Return the KITTI-FC EPE, CRE and RCRE of 29 variants and the GoPro-FC RCRE of 11."""
    costs = published_costs()
    lines = merged(line for table in _TABLES for line in parse_results(_text(table), f"{table}.csv", PAPER))
    return tuple(
        replace(
            line,
            published=True,
            printed_cost=costs.get(line.name) if benchmark_facts(line.benchmark).has_flow else None,
        )
        for line in lines
    )


@cache
def published_costs() -> dict[str, PrintedCost]:
    """Return Tab. 3 by model, in the paper's order."""
    lines = enumerate(csv.DictReader(_text("cost").splitlines()))
    rows = ({name: cell or None for name, cell in line.items()} | {"row": row} for row, line in lines)
    return {cost.model: cost for cost in map(PrintedCost.model_validate, rows)}


def not_discussed(results: Iterable[ModelResult]) -> tuple[str, ...]:
    """List the models that figures and observations omit: for the paper's results, the learned models that the
    paper omits from its discussion (Sec. 5.2); for all other results, none.
    """
    return _NOT_DISCUSSED if of_paper(results) else ()


def of_paper(results: Iterable[ModelResult]) -> bool:
    """Whether the results include published values."""
    return any(line.frames == PAPER for line in results)


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
