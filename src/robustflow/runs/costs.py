"""The cost of a run's model, measured by `robustflow profile MODEL --into RUN` and stored with the run's rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from ..errors import UsageError
from ..text import plain
from .attachment import RunAttachment, parse_attachment, read_attachment, write_attachment

if TYPE_CHECKING:
    from .run import Run

PROFILE = "profile.json"
COUNTED_SIZE = (432, 720)
"""Height and width of the frames for which the paper reports costs, in pixels."""

_LARGEST = 1 << 16
_COMMAND = "profile MODEL --into RUN"

_NOT_COMPARED = {
    *("checkpoint", "options", "runtime", "input", "device", "precision", "compile", "threads", "torch"),
}
"""Parts of a model's identity that do not affect its cost, or that follow from its name."""

_Count = Annotated[int, Field(ge=0, le=10**18)]


class RunCost(RunAttachment):
    """The cost of one prediction of a run's model."""

    height: Annotated[int, Field(ge=1, le=10**5)]
    width: Annotated[int, Field(ge=1, le=10**5)]
    iterations: Annotated[int, Field(ge=0, le=10**6)] | None = None
    parameters: _Count
    macs: _Count
    thop_parameters: _Count
    thop_macs: _Count
    seconds: Annotated[float, Field(ge=0)] | None = None
    peak_bytes: _Count | None = None
    device: Annotated[str, Field(max_length=40)] | None = None

    @property
    def parameters_m(self) -> float:
        """Return the parameters in millions, counted as in the paper."""
        return self.thop_parameters / 1e6

    @property
    def flops_g(self) -> float:
        """Return the FLOPs as reported in the paper: thop's multiply-accumulates, in units of 10^9."""
        return self.thop_macs / 1e9


def parse_cost(data: bytes, name: str) -> RunCost:
    """Parse a cost from its file."""
    return parse_attachment(RunCost, data, name, _COMMAND)


def read_cost(run: Run) -> RunCost | None:
    """Return the cost stored in a run's folder; None if it was not measured."""
    return read_attachment(RunCost, run, PROFILE, _LARGEST, _COMMAND)


def check_profiled_model(run: Run, model: Mapping[str, Any]) -> None:
    """Check that a model has the identity of a run's model, ignoring weights and execution settings."""
    ran = run.manifest.identity.model.settings
    for key in sorted((ran.keys() | model.keys()) - _NOT_COMPARED):
        before, here = (json.dumps(of.get(key), sort_keys=True, default=str) for of in (ran, model))
        if before != here:
            raise UsageError(
                f"{run.path} has a different model: its {key} is {plain(before)}, "
                f"but the given model has {plain(here)}; profile the run's model with the run's options"
            )


def write_cost(run: Run, cost: RunCost) -> Path:
    """Store a cost in the folder of its run."""
    return write_attachment(run, PROFILE, cost)
