"""Ranks by cost and relative robustness: the paper's Tab. 3 and, by the same rule, ranks among runs."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import polars as pl

from ..runs.comparable import sample_set
from ..runs.costs import RunCost, read_cost
from ..runs.run import Run
from .published.tables import Cost
from .ranking import average_ranks, competition_ranks
from .results import AVERAGE, CLEAN
from .run_names import run_names

Measured = tuple[str, str, str]
"""(sample set, setting, model)."""


@dataclass(frozen=True)
class RunRanks:
    """Ranks of a run, None if there is nothing to compare with: by CREr in its setting, by FLOPs among those counted at
    the same input size, and by both (see `ranking`)."""

    crer: int | None
    flops: int | None
    average: int | None


def cost_ranks(costs: Mapping[str, Cost]) -> dict[str, dict[str, int]]:
    """Ranks computed from the values of `costs`: "flops", "crer_ood", "crer_id", "average_ood", "average_id" by model.

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


def run_costs(runs: Sequence[Run]) -> dict[tuple[str, str], RunCost]:
    """Costs by (sample set, name) as `run_results` gives them; runs without one are left out."""
    costs = {(sample_set(run), name): read_cost(run) for name, run in zip(run_names(runs), runs, strict=True)}
    return {key: cost for key, cost in costs.items() if cost is not None}


def measured_crer(results: pl.DataFrame) -> dict[Measured, tuple[float, str]]:
    """(sample set, setting, model) -> (CREr, note): as given, or computed from the average and the clean EPE."""
    by_model: dict[tuple[str, str, str], dict[tuple[str, str], float]] = {}
    notes = {}
    for row in results.iter_rows(named=True):
        key = (row["sample_set"], row["setting"], row["model"])
        by_model.setdefault(key, {})[row["metric"], row["corruption"]] = row["value"]
        notes[key] = row["note"]
    out = {}
    for key, values in by_model.items():
        given, clean, epe = (values.get(k) for k in (("crer", AVERAGE), ("epe", CLEAN), ("epe", AVERAGE)))
        if given is None and epe is not None and clean:
            given = (epe - clean) / clean
        if given is not None:
            out[key] = (given, notes[key])
    return out


def run_ranks(
    measured: Mapping[Measured, tuple[float, str]],
    run_costs: Mapping[tuple[str, str], RunCost],
    doubted: Container[tuple[str, str]] = (),
) -> dict[Measured, RunRanks]:
    """Ranks of models that are not from the paper, among those of their setting on the same frames.

    Args:
        measured: the result of `measured_crer`.
        run_costs: of runs, by (sample set, name).
        doubted: runs that get no rank, and against which the others are not ranked.
    """
    sound = {key: value for key, value in measured.items() if (key[0], key[2]) not in doubted}
    known = {key: run_costs[key[0], key[2]] for key in sound if (key[0], key[2]) in run_costs}
    ranks = dict.fromkeys(measured, RunRanks(None, None, None))
    for key in sound:
        crer = _ranks({k: round(value, 2) for k, (value, _) in sound.items() if k[:2] == key[:2]})
        flops = _ranks(
            {
                k: round(other.flops_g, 1)
                for k, other in known.items()
                if key in known and k[0] == key[0] and counted_size(other) == counted_size(known[key])
            }
        )
        average = average_ranks(crer, flops)
        ranks[key] = RunRanks(crer.get(key), flops.get(key), average.get(key) if len(average) > 1 else None)
    return ranks


def _ranks(values: Mapping[Measured, float]) -> dict[Measured, int]:
    """Ranks; none for a single model."""
    return competition_ranks(values) if len(values) > 1 else {}


def counted_size(cost: RunCost) -> tuple[int, int]:
    """Height and width of the frames for which a cost was counted."""
    return cost.height, cost.width
