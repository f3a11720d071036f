"""torchvision's RAFT (Teed and Deng, ECCV 2020), large and small. Building a model requires the torch extra."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.arguments import check_count
from ..conventions import RAFT_SMALLEST, InputConvention
from ..execution import Execution
from .build import SOURCES, check_available, network_model

if TYPE_CHECKING:
    from .network_model import NetworkModel

_SOURCE = SOURCES["torchvision"]


def _raft(
    name: str,
    checkpoint: str | Path | None = None,
    *,
    iterations: int = 12,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> NetworkModel:
    """Build torchvision's RAFT; frames are padded to multiples of 8 by repeating the border."""
    check_count("iterations", iterations)
    check_available(name, checkpoint, "torchvision", _SOURCE)
    from torchvision import __version__ as version
    from torchvision.models import optical_flow

    def build() -> Any:
        from .network_model import TorchvisionRaft

        return TorchvisionRaft(getattr(optical_flow, name)(weights=None), iterations)

    kinds = {"raft_large": optical_flow.Raft_Large_Weights, "raft_small": optical_flow.Raft_Small_Weights}
    return network_model(
        name,
        build,
        InputConvention(scale=1.0, fit="pad", multiple=8, smallest=RAFT_SMALLEST),
        checkpoint,
        source=_SOURCE,
        sha256=sha256,
        published={weights.name: weights.url for weights in kinds[name]},
        settings={
            "iterations": iterations,
            "library": f"torchvision {version}",
            "normalisation": "-1..1",
        },
        execution=Execution(device, precision, compile, threads),
    )


raft_large = partial(_raft, "raft_large")
raft_small = partial(_raft, "raft_small")
