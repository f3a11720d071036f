"""Reproduce the parameters and FLOPs in the paper's Tab. 3 with the paper's method (Sec. 4.2).

The paper's FLOPs are thop's multiply-accumulates for 12 iterations at 1x3x432x720; for ARFlow they are measured at
256x832, the size to which it resizes KITTI. FlowFormer++ was counted without the padding to multiples of 32 that is
used in prediction. BrightFlow and SAMFlow were counted with a full-resolution flow after every iteration, as in
training; in prediction, our versions only upsample the last flow, which saves the computation of eleven upsampling
masks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from ..core.errors import AssetError, ModelError
from ..models import load_model
from ..models.catalog import methods
from ..models.torch.network import RANDOM
from .profile import Counts, count, network_of

_UNPADDED = ("flowformer_pp",)
_EVERY_FLOW = ("brightflow", "samflow_t", "samflow_b", "samflow_h")


class EveryFlow(nn.Module):
    """Wrapper that makes a network compute all its `flows`, one per iteration, instead of only the last one."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, image1: Tensor, image2: Tensor) -> Any:
        """Return the result of the network's method `flows` for images (1, 3, H, W)."""
        return self.net.flows(image1, image2)


@dataclass(frozen=True)
class Counted:
    """One method from the paper's table, with costs counted by the paper's procedure."""

    method: str
    size: tuple[int, int]
    counts: Counts | None
    missing: str = ""


def count_as_the_paper(published: Iterable[str], frames: tuple[int, int]) -> Iterator[Counted]:
    """Count the costs of the methods, one method at a time."""
    names = {entry.method: name for name, entry in methods().items()}
    for method in published:
        name = names[method]
        try:
            model = network_of(load_model(name, checkpoint=RANDOM, device="cpu"))
        except (AssetError, ModelError) as error:
            yield Counted(method, frames, None, str(error))
            continue
        if name in _UNPADDED:
            model.net.model.output_stride = 8
        size = model.convention.fitted_size(*frames)
        net = EveryFlow(model.net) if name in _EVERY_FLOW else model.net
        yield Counted(method, size, count(net, *size))
