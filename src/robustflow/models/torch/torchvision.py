"""torchvision's RAFT (Teed and Deng, ECCV 2020), large and small. Needs the torch extra when it is built."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..input_convention import RAFT_SMALLEST, InputConvention
from ..option_checks import check_count
from .network import network_model, require

if TYPE_CHECKING:
    from .model import TorchModel


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
) -> TorchModel:
    """RAFT as torchvision has it, padded to multiples of 8 by repeating the border.

    Args:
        name: "raft_large" or "raft_small".
        checkpoint: torchvision's name of the weights (C_T_V2, C_T_SKHT_V2, ...), a file of them, or "random".
        iterations: of the recurrent update.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    check_count("iterations", iterations)
    require("torchvision", "torch", name)
    from torchvision import __version__ as version
    from torchvision.models import optical_flow

    def build() -> Any:
        from .raft_net import TorchvisionRaft

        return TorchvisionRaft(getattr(optical_flow, name)(weights=None), iterations)

    kinds = {"raft_large": optical_flow.Raft_Large_Weights, "raft_small": optical_flow.Raft_Small_Weights}
    return network_model(
        name,
        build,
        InputConvention(scale=1.0, fit="pad", multiple=8, smallest=RAFT_SMALLEST),
        checkpoint,
        source="a file of https://download.pytorch.org/models",
        sha256=sha256,
        published={weights.name: weights.url for weights in kinds[name]},
        settings={
            "iterations": iterations,
            "library": f"torchvision {version}",
            "normalisation": "-1..1",
        },
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )


raft_large = partial(_raft, "raft_large")
raft_small = partial(_raft, "raft_small")
