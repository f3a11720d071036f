"""The cost of a run's network, counted when the run is done and stored with its rows."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

from ..errors import RobustFlowError
from ..runs.costs import COUNTED_SIZE, PROFILE, RunCost, write_cost
from ..runs.run import Run


def keep_cost(run: Run, model: Any) -> None:
    """Store what one prediction of a run's model costs, unless it is stored already, for the run's tables and pages.

    Only PyTorch networks of this project can be counted; of other models nothing is stored. Nothing is predicted, so it
    takes about a second.

    Args:
        run: whose folder this process has locked or just finished.
        model: of the run, as it was loaded.

    Raises:
        DataError: the folder cannot be written.
    """
    if "torch" not in sys.modules or (run.path / PROFILE).exists():
        return  # without PyTorch loaded there is no network, and importing it costs more than a small run
    from ..profiling.counts import count
    from ..profiling.network_of import network_of

    try:
        network = network_of(model)
        counts = count(network.net, *network.convention.fitted_size(*COUNTED_SIZE))
    except RobustFlowError:
        return  # not a network, or not one that can be counted at this size
    height, width = COUNTED_SIZE
    identity = run.manifest.identity_digest
    rounds = network.identity().get("iterations")
    write_cost(run, RunCost(run=identity, height=height, width=width, iterations=rounds, **asdict(counts)))
