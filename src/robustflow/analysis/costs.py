"""What the models of runs cost, by the names that tables give the runs."""

from __future__ import annotations

from collections.abc import Sequence

from ..runs.costs import RunCost, read_cost
from ..runs.run import Run
from .scores import run_names, sample_set


def run_costs(runs: Sequence[Run]) -> dict[tuple[str, str], RunCost]:
    """Costs by (sample set, name) as `run_results` gives them; runs without one are left out.

    Raises:
        RunError: a cost file is damaged, or was counted for another run.
    """
    costs = {(sample_set(run), name): read_cost(run) for name, run in zip(run_names(runs), runs, strict=True)}
    return {key: cost for key, cost in costs.items() if cost is not None}
