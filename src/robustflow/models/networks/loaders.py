"""The networks implemented in this project: one function that loads each of them with its checkpoint, and where their
weights are published. Importable without the torch extra, which building a network requires.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from ...core.arguments import check_count, check_switch, parse_size
from ...core.errors import UsageError
from ..conventions import InputConvention
from ..execution import Execution
from ..protocols import AnyModel
from ..tiling import tiled
from ..torch.build import network_model


class PublishedNetwork(NamedTuple):
    """Where a network's weights are published, and the input for which they were trained."""

    source: str
    convention: InputConvention


_SAMFLOW = PublishedNetwork(
    "the authors' file of this size, linked from https://github.com/zslzx/SAMFlow",
    InputConvention(scale=1.0, fit="pad", multiple=16),
)

NETWORKS = {
    "arflow": PublishedNetwork(
        "pwclite_ar.tar (or pwclite_raw.tar) from the folder checkpoints/ of https://github.com/lliuz/ARFlow",
        InputConvention(fit="stretch", multiple=64),
    ),
    "upflow": PublishedNetwork(
        "upflow_kitti2015.pth from https://github.com/coolbeam/UPFlow_pytorch",
        InputConvention(mean=(104.920005, 110.1753, 114.785955), scale=0.0039216),
    ),
    "brightflow": PublishedNetwork(
        "the RAFT checkpoint from https://github.com/CEA-LIST/BrightFlow",
        InputConvention(mean=(127.5, 127.5, 127.5), scale=2 / 255, fit="pad", multiple=8),
    ),
    "samflow_t": _SAMFLOW,
    "samflow_b": _SAMFLOW,
    "samflow_h": _SAMFLOW,
    "flowdiffuser": PublishedNetwork(
        "the authors' file, linked from https://github.com/LA30/FlowDiffuser",
        InputConvention(scale=1.0, fit="pad", multiple=8, vertical="bottom"),
    ),
}
"""The networks, keyed by the names used to load them."""


def arflow(
    checkpoint: str | Path | None = None,
    *,
    size: str = "256x832",
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """Load the network of Liu et al., "Learning by Analogy", CVPR 2020. The paper's costs are for 256x832, the authors'
    size for KITTI; their size for Sintel is 448x1024. "native" is the frame's size, rounded up to a multiple of 64."""
    fixed = None if size == "native" else parse_size(size, 64)

    def build() -> Any:
        from .arflow import ARFlow

        return ARFlow()

    return _loaded("arflow", build, checkpoint, sha256, Execution(device, precision, compile, threads), size=fixed)


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
) -> AnyModel:
    """Load the network of Luo et al., CVPR 2021.

    Args:
        align_corners: the weights were trained with True; on PyTorch 1.3 and later, the authors' code uses False.
        mask_threshold: warped features are set to zero where the bilinear weights inside the frame sum to less than
            this; with the authors' value 1.0, rounding also zeroes some pixels inside the frame, and which ones depends
            on the machine.
    """
    check_switch("align_corners", align_corners)
    if isinstance(mask_threshold, bool) or not isinstance(mask_threshold, int | float) or not 0 <= mask_threshold <= 1:
        raise UsageError("mask_threshold", f"must be a number from 0 to 1, not {mask_threshold!r}")

    def build() -> Any:
        from .upflow import UPFlow

        return UPFlow(align_corners, mask_threshold)

    settings = {"align_corners": align_corners, "mask_threshold": mask_threshold}
    return _loaded("upflow", build, checkpoint, sha256, Execution(device, precision, compile, threads), settings)


def brightflow(
    checkpoint: str | Path | None = None,
    *,
    iterations: int = 12,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """Load the network of Marsal et al., WACV 2023: RAFT trained without labels. The brightness corrector in the file
    is ignored."""
    check_count("iterations", iterations)

    def build() -> Any:
        from .brightflow import BrightFlow

        return BrightFlow(iterations)

    execution = Execution(device, precision, compile, threads)
    return _loaded("brightflow", build, checkpoint, sha256, execution, {"iterations": iterations}, scope="model.")


def _samflow(
    size: Literal["tiny", "base", "huge"],
    checkpoint: str | Path | None = None,
    *,
    finetuned: bool = False,
    iterations: int = 12,
    tile: str = "432x960",
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """Load SAMFlow in one of its sizes (Zhou et al., AAAI 2024).

    Args:
        finetuned: whether the file is of the network fine-tuned on Sintel, which contains `wadd_1.add_weight`.
        iterations: the authors evaluate with 24 on KITTI and 32 on Sintel.
        tile: size of the tiles, because the ViT encoders accept frames of up to 1024 pixels per side.
    """
    check_switch("finetuned", finetuned)
    check_count("iterations", iterations)
    if finetuned and size != "huge":
        raise UsageError("finetuned", "only samflow_h was published fine-tuned; omit this option")

    def build() -> Any:
        from .samflow import SamFlow

        return SamFlow(size, finetuned, iterations)

    settings = {"finetuned": finetuned, "iterations": iterations}
    execution = Execution(device, precision, compile, threads)
    return tiled(_loaded(f"samflow_{size[0]}", build, checkpoint, sha256, execution, settings), tile)


samflow_t = partial(_samflow, "tiny")
samflow_b = partial(_samflow, "base")
samflow_h = partial(_samflow, "huge")


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
) -> AnyModel:
    """Load the network of Luo et al., CVPR 2024, at the frame's size; the numbers of steps and iterations are part of
    the method.

    Args:
        seed: seed of the noise from which all pairs of equal size start.
        vertical: position of the padding rows: "bottom" as the authors use it for KITTI, "both" for Sintel.
    """
    if type(seed) is not int:  # in Python, True is an int
        raise UsageError("seed", f"must be an integer, not {seed!r}")
    if vertical not in ("bottom", "both"):
        raise UsageError("vertical", f"must be bottom (KITTI) or both (Sintel), not {vertical!r}")

    def build() -> Any:
        from .flowdiffuser import FlowDiffuser

        return FlowDiffuser(seed)

    execution = Execution(device, precision, compile, threads)
    return _loaded("flowdiffuser", build, checkpoint, sha256, execution, {"seed": seed}, vertical=vertical)


def _loaded(
    name: str,
    build: Callable[[], Any],
    checkpoint: str | Path | None,
    sha256: str | None,
    execution: Execution,
    settings: dict[str, Any] | None = None,
    scope: str | None = None,
    **convention: Any,
) -> AnyModel:
    """Load a network of the table; keyword arguments change its input convention."""
    source, as_trained = NETWORKS[name]
    return network_model(
        name,
        build,
        replace(as_trained, **convention),
        checkpoint,
        source=source,
        sha256=sha256,
        scope=scope,
        settings=settings,
        execution=execution,
    )
