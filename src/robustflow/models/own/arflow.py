"""ARFlow (Liu et al., "Learning by Analogy", CVPR 2020) as a flow model. Needs the torch extra when it is built."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..input_convention import InputConvention, parse_size
from ..torch.network import network_model

if TYPE_CHECKING:
    from ..torch.model import TorchModel

SOURCE = "pwclite_ar.tar (or pwclite_raw.tar) from the folder checkpoints/ of https://github.com/lliuz/ARFlow"


def arflow(
    checkpoint: str | Path | None = None,
    *,
    size: str = "256x832",
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """ARFlow's two-frame network. One pass, so it has no iterations.

    Args:
        checkpoint: the authors' file for two frames.
        size: HEIGHTxWIDTH every frame is stretched to, as the authors do: 256x832 for KITTI (the default, and what
            the paper profiles), 448x1024 for Sintel; or "native" for the frame's own size, rounded up to multiples
            of 64.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    target = None if size == "native" else parse_size(size, 64)

    def build() -> Any:
        from .nets.arflow import ARFlow

        return ARFlow()

    return network_model(
        "arflow",
        build,
        InputConvention(fit="stretch", multiple=64, size=target),
        checkpoint,
        source=SOURCE,
        sha256=sha256,
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
