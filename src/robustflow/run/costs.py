"""Small untrusted files that are stored in a run's folder and belong to exactly one run; the cost of its model."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from ..core.errors import RobustFlowError, RunError, UsageError
from ..core.files import write_bytes
from ..core.text import plain
from ..core.types import Untrusted
from .trust import document_bytes, read_document

if TYPE_CHECKING:
    from .run import Run

PROFILE = "profile.json"
COUNTED_SIZE = (432, 720)
"""Height and width of the frames for which the paper reports costs, in pixels."""
_LARGEST = 1 << 20

_NOT_COMPARED = {"checkpoint", "options", "runtime", "input", "device", "precision", "compile", "threads", "torch"}
"""Parts of a model's identity that do not affect its cost, or that follow from its name."""

_Count = Annotated[int, Field(ge=0, le=10**18)]


class RunAttachment(Untrusted):
    """Base of the files; each contains the digest of its run's identity."""

    FILE: ClassVar[str]
    COMMAND: ClassVar[str]
    """The command that writes the file."""

    version: Annotated[int, Field(ge=1, le=1)] = 1
    run: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]

    @classmethod
    def remedy(cls) -> str:
        return f"delete it, or recreate it with robustflow {cls.COMMAND} --into RUN"

    @classmethod
    def read(cls, run: Run) -> Self | None:
        """Read the file from a run's folder; None if it does not exist."""
        path = run.path / cls.FILE
        content = read_document(cls, path, _LARGEST, cls.remedy())
        if content is not None and content.run != run.manifest.identity_digest:
            raise RunError(path, f"belongs to a different run ({content.run}); {cls.remedy()}")
        return content

    def write(self, folder: Path) -> Path:
        """Write the file into a run's folder."""
        write_bytes(folder / self.FILE, document_bytes(self.model_dump()))
        return folder / self.FILE


class RunCost(RunAttachment):
    """The cost of one prediction of a run's model."""

    FILE = PROFILE
    COMMAND = "profile MODEL"

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


def keep_cost(run: Run, model: Any) -> None:
    """Store the cost of one prediction by a run's model for the run's tables and pages, unless it is already stored."""
    if "torch" not in sys.modules or (run.path / PROFILE).exists():
        # if PyTorch is not loaded, the model cannot be a network; importing it would take longer than a small run
        return
    from ..models.profile import count_prediction, network_of

    height, width = COUNTED_SIZE
    try:
        counts = count_prediction(model, height, width)
    except RobustFlowError:
        return  # not a network, or its cost cannot be determined at this size
    rounds = network_of(model).identity().get("iterations")
    identity = run.manifest.identity_digest
    RunCost(run=identity, height=height, width=width, iterations=rounds, **asdict(counts)).write(run.path)


def check_profiled_model(run: Run, model: Mapping[str, Any]) -> None:
    """Check that a model has the identity of a run's model, ignoring weights and execution settings."""
    ran = run.manifest.identity.model.settings
    for key in sorted((ran.keys() | model.keys()) - _NOT_COMPARED):
        before, here = (json.dumps(of.get(key), sort_keys=True, default=str) for of in (ran, model))
        if before != here:
            raise UsageError(
                key,
                f"{run.path} has a different model: {plain(before)}, but the given model has {plain(here)}; profile "
                "the run's model with the run's options",
            )
