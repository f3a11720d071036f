"""SAMFlow (Zhou et al., AAAI 2024) as a flow model. Needs the torch extra when it is built."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal

from ..base import AnyModel
from ..input_convention import InputConvention
from ..option_checks import check_count, check_switch
from ..tiling import tiled
from ..torch.network import network_model

SOURCE = "the authors' file of this size, linked from https://github.com/zslzx/SAMFlow"
TILE = "432x960"


def _samflow(
    name: str,
    size: Literal["tiny", "base", "huge", "huge_finetuned"],
    checkpoint: str | Path | None = None,
    *,
    iterations: int = 12,
    tile: str | None = TILE,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """SAMFlow with one of its SAM encoders.

    Args:
        name: of the model.
        size: see `nets.samflow.SamFlow`.
        checkpoint: the authors' file.
        iterations: of the decoder. The paper takes 12; SAMFlow's authors evaluate with 24 on KITTI and 32 on Sintel.
        tile: HEIGHTxWIDTH of the tiles to predict in, by default the authors'; "none" for whole frames, which the
            ViT encoders take up to 1024 pixels.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.
    """
    check_count("iterations", iterations)

    def build() -> Any:
        from .nets.samflow import SamFlow

        return SamFlow(size, iterations)

    model = network_model(
        name,
        build,
        InputConvention(scale=1.0, fit="pad", multiple=16),
        checkpoint,
        source=SOURCE,
        sha256=sha256,
        settings={"iterations": iterations, "finetuned": size == "huge_finetuned"},
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
    return tiled(model, tile)


samflow_t = partial(_samflow, "samflow_t", "tiny")
samflow_b = partial(_samflow, "samflow_b", "base")


def samflow_h(
    checkpoint: str | Path | None = None,
    *,
    finetuned: bool = False,
    iterations: int = 12,
    tile: str | None = TILE,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """SAMFlow with the largest SAM encoder; arguments as for the others.

    Args:
        finetuned: the checkpoint is the one fine-tuned on Sintel, whose network differs: it holds
            `wadd_1.add_weight`, the one for FlyingThings does not.
    """
    check_switch("finetuned", finetuned)
    return _samflow(
        "samflow_h",
        "huge_finetuned" if finetuned else "huge",
        checkpoint,
        iterations=iterations,
        tile=tile,
        sha256=sha256,
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )
