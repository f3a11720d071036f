"""FlowDiffuser (Luo et al., CVPR 2024) as a flow model. Needs the torch extra when it is built."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import UsageError
from ..input_convention import InputConvention
from ..torch.network import network_model

if TYPE_CHECKING:
    from ..torch.model import TorchModel

CONVENTION = InputConvention(scale=1.0, fit="pad", multiple=8, vertical="bottom")
SOURCE = "the authors' file, linked from https://github.com/LA30/FlowDiffuser"


def flowdiffuser(
    checkpoint: str | Path | None = None,
    *,
    seed: int = 0,
    vertical: str = "bottom",
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """FlowDiffuser at the frame's own size. Its numbers of steps and iterations are part of the method.

    Args:
        checkpoint: the authors' file.
        seed: of the noise that the flow is denoised from. Every pair of one size starts from the same noise, so that
            neither the order nor the batch has a part in the result.
        vertical: where rows are added: "bottom" as the authors do on KITTI, "both" as they do on Sintel.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    if type(seed) is not int:  # True is an int to Python
        raise UsageError(f"seed must be a whole number, not {seed!r}")
    if vertical not in ("bottom", "both"):
        raise UsageError(f"vertical must be bottom (KITTI) or both (Sintel), not {vertical!r}")

    def build() -> Any:
        from .nets.flowdiffuser import FlowDiffuser

        return FlowDiffuser(seed)

    return network_model(
        "flowdiffuser",
        build,
        CONVENTION if vertical == "bottom" else replace(CONVENTION, vertical="both"),
        checkpoint,
        source=SOURCE,
        sha256=sha256,
        settings={"seed": seed},
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
