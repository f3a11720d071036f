"""BrightFlow (Marsal et al., WACV 2023) as a flow model. Needs the torch extra when it is built."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..input_convention import InputConvention
from ..option_checks import check_count
from ..torch.network import network_model

if TYPE_CHECKING:
    from ..torch.model import TorchModel

SOURCE = "the RAFT checkpoint of https://github.com/CEA-LIST/BrightFlow"


def brightflow(
    checkpoint: str | Path | None = None,
    *,
    iterations: int = 12,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """BrightFlow's network, RAFT trained without labels, padded to multiples of 8 by repeating the border.

    Args:
        checkpoint: the authors' file; what it holds beside the network (the brightness corrector, losses) is left out.
        iterations: of the recurrent update; the paper's evaluation takes 12.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    check_count("iterations", iterations)

    def build() -> Any:
        from .nets.brightflow import BrightFlow

        return BrightFlow(iterations)

    return network_model(
        "brightflow",
        build,
        InputConvention(mean=(127.5, 127.5, 127.5), scale=2 / 255, fit="pad", multiple=8),
        checkpoint,
        source=SOURCE,
        sha256=sha256,
        scope="model.",
        settings={"iterations": iterations},
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
