"""UPFlow (Luo et al., CVPR 2021) as a flow model. Needs the torch extra when it is built."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import UsageError
from ..input_convention import InputConvention
from ..option_checks import check_switch
from ..torch.network import network_model

if TYPE_CHECKING:
    from ..torch.model import TorchModel

SOURCE = "upflow_kitti2015.pth from https://github.com/coolbeam/UPFlow_pytorch"


def upflow(
    checkpoint: str | Path | None = None,
    *,
    align_corners: bool = True,
    mask_threshold: float = 0.9999,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """UPFlow's network, at the frame's own size. One pass, so it has no iterations.

    Args:
        checkpoint: the authors' file.
        align_corners: how warps sample. True is what the weights were trained with; False is what the authors' code
            does on PyTorch 1.3 and later.
        mask_threshold: features fetched from beyond the frame are zeroed where their bilinear weights sum to less.
            The authors compare with 1.0, where rounding zeroes pixels inside the frame at random, differently on
            every machine.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    check_switch("align_corners", align_corners)
    if isinstance(mask_threshold, bool) or not isinstance(mask_threshold, int | float) or not 0 <= mask_threshold <= 1:
        raise UsageError(f"mask_threshold must be a number from 0 to 1, not {mask_threshold!r}")

    def build() -> Any:
        from .nets.upflow import Sampling, UPFlow

        return UPFlow(Sampling(align_corners, mask_threshold))

    return network_model(
        "upflow",
        build,
        InputConvention(mean=(104.920005, 110.1753, 114.785955), scale=0.0039216),
        checkpoint,
        source=SOURCE,
        sha256=sha256,
        settings={"align_corners": align_corners, "mask_threshold": mask_threshold},
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
