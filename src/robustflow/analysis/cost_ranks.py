"""Rank models by cost and relative robustness, as in the paper's Tab. 3."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..runs.costs import RunCost
from .model_result import ModelResult, PrintedCost, ranked
from .ranking import average_ranks, competition_ranks


@dataclass(frozen=True)
class RunRanks:
    """Ranks of a run by CREr within its setting, by FLOPs among models whose FLOPs were counted at the same input size,
    and by both (see `ranking`); None if there is nothing to compare with."""

    crer: int | None
    flops: int | None
    average: int | None


def printed_costs(results: Iterable[ModelResult]) -> dict[str, PrintedCost]:
    """Return the paper's costs for the models in the results, by model name, in the order of Tab. 3."""
    costs = {line.name: line.printed_cost for line in results if line.printed_cost is not None}
    return dict(sorted(costs.items(), key=lambda item: item[1].row))


def printed_cost_ranks(results: Iterable[ModelResult]) -> dict[str, dict[str, int]]:
    """Rank the models with a printed cost by "flops", "crer_ood", "crer_id", "average_ood" and "average_id".

    >>> from robustflow.analysis.published.tables import published_results
    >>> printed_cost_ranks(published_results())["average_id"]["CSFlow"]
    4
    """
    costs = printed_costs(results)
    ranks = {"flops": competition_ranks({name: cost.flops_g for name, cost in costs.items()})}
    for setting in ("ood", "id"):
        known = {name: getattr(cost, f"crer_{setting}") for name, cost in costs.items()}
        ranks[f"crer_{setting}"] = competition_ranks(
            {name: value for name, value in known.items() if value is not None}
        )
        ranks[f"average_{setting}"] = average_ranks(ranks[f"crer_{setting}"], ranks["flops"])
    return ranks


def run_ranks(results: Sequence[ModelResult]) -> dict[ModelResult, RunRanks]:
    """Rank every model that has a CREr within its setting, on the same frames. Excluded models get no rank and
    do not affect the ranks of the others."""
    measured = [line for line in results if line.crer is not None]
    sound = ranked(measured)
    ranks = dict.fromkeys(measured, RunRanks(None, None, None))
    for line in sound:
        peers = [other for other in sound if other.frames == line.frames]
        crer = _ranks({one: round(one.crer or 0.0, 2) for one in peers if one.setting == line.setting})
        size = line.cost and counted_size(line.cost)
        alike = {one: one.cost for one in peers if one.cost is not None and counted_size(one.cost) == size}
        flops = _ranks({one: round(cost.flops_g, 1) for one, cost in alike.items()})
        average = average_ranks(crer, flops)
        ranks[line] = RunRanks(crer.get(line), flops.get(line), average.get(line) if len(average) > 1 else None)
    return ranks


def _ranks(values: Mapping[ModelResult, float]) -> dict[ModelResult, int]:
    """Return the ranks; empty for a single model."""
    return competition_ranks(values) if len(values) > 1 else {}


def counted_size(cost: RunCost) -> tuple[int, int]:
    """Return the height and width of the frames for which the cost was computed."""
    return cost.height, cost.width
