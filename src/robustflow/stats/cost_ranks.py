"""Rank the paper's models by cost and relative robustness, as in its Tab. 3."""

from __future__ import annotations

from collections.abc import Iterable

from ..run.costs import RunCost
from .model_result import ModelResult, PrintedCost
from .ranking import average_ranks, competition_ranks


def printed_costs(results: Iterable[ModelResult]) -> dict[str, PrintedCost]:
    """Return the paper's costs for the models in the results, by model name, in the order of Tab. 3."""
    costs = {line.name: line.printed_cost for line in results if line.printed_cost is not None}
    return dict(sorted(costs.items(), key=lambda item: item[1].row))


def printed_cost_ranks(results: Iterable[ModelResult]) -> dict[str, dict[str, int]]:
    """Rank the models with a printed cost by "flops", "crer_ood", "crer_id", "average_ood" and "average_id"."""
    costs = printed_costs(results)
    ranks = {"flops": competition_ranks({name: cost.flops_g for name, cost in costs.items()})}
    for setting in ("ood", "id"):
        known = {name: getattr(cost, f"crer_{setting}") for name, cost in costs.items()}
        ranks[f"crer_{setting}"] = competition_ranks(
            {name: value for name, value in known.items() if value is not None}
        )
        ranks[f"average_{setting}"] = average_ranks(ranks[f"crer_{setting}"], ranks["flops"])
    return ranks


def counted_size(cost: RunCost) -> tuple[int, int]:
    """Return the height and width of the frames for which the cost was computed."""
    return cost.height, cost.width
