"""Determine the cost of a run's network at the end of the run, and store it with the rows."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

from ..core.errors import RobustFlowError
from .costs import COUNTED_SIZE, PROFILE, RunCost, write_cost
from .run import Run


def keep_cost(run: Run, model: Any) -> None:
    """Store the cost of one prediction by a run's model for the run's tables and pages, unless it is already stored."""
    if "torch" not in sys.modules or (run.path / PROFILE).exists():
        # if PyTorch is not loaded, the model cannot be a network; importing it would take longer than a small run
        return
    from .profile import count_prediction, network_of

    try:
        counts = count_prediction(model, *COUNTED_SIZE)
    except RobustFlowError:
        return  # not a network, or its cost cannot be determined at this size
    height, width = COUNTED_SIZE
    identity = run.manifest.identity_digest
    rounds = network_of(model).identity().get("iterations")
    write_cost(run, RunCost(run=identity, height=height, width=width, iterations=rounds, **asdict(counts)))
