"""The paper's Tab. 3, parameters and FLOPs, counted again the way it was counted (Sec. 4.2).

Its FLOPs are thop's multiply-accumulates of 12 iterations on 1x3x432x720; ARFlow's are of the 256x832 that it
stretches KITTI to. FlowFormer++ was counted without the padding to multiples of 32 that it gets when it predicts.
BrightFlow and SAMFlow were counted with a full-resolution flow after every iteration, as in training; ours make the
last alone when they predict, which saves eleven masks of upsampling weights.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from ..errors import AssetError, ModelError
from ..models import load_model
from ..models.catalog import methods
from ..models.torch.find_checkpoint import RANDOM
from .counts import Counts, count
from .network_of import network_of

_UNPADDED = ("flowformer_pp",)
_EVERY_FLOW = ("brightflow", "samflow_t", "samflow_b", "samflow_h")


class EveryFlow(nn.Module):
    """A network whose `flows` are computed, one for every iteration, where its own call gives the last."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, image1: Tensor, image2: Tensor) -> Any:
        """Images (1, 3, H, W) to what `flows` of the network gives."""
        return self.net.flows(image1, image2)


@dataclass(frozen=True)
class Counted:
    """A method of the paper's table, counted the way the paper counted it.

    Attributes:
        method: what its paper calls it.
        model: the name it is loaded by.
        size: (height, width) it was counted at.
        counts: ours; None where the model is not available here, and `missing` says why.
    """

    method: str
    model: str
    size: tuple[int, int]
    counts: Counts | None
    missing: str = ""


def count_as_the_paper(published: Iterable[str], frames: tuple[int, int]) -> Iterator[Counted]:
    """One method after the other.

    Args:
        published: methods of the catalogue, as their papers call them.
        frames: height and width.
    """
    names = {entry.method: name for name, entry in methods().items()}
    for method in published:
        name = names[method]
        try:
            model = network_of(load_model(name, checkpoint=RANDOM, device="cpu"))
        except (AssetError, ModelError) as error:
            yield Counted(method, name, frames, None, str(error))
            continue
        if name in _UNPADDED:
            model.net.model.output_stride = 8
        size = model.convention.fitted_size(*frames)
        net = EveryFlow(model.net) if name in _EVERY_FLOW else model.net
        yield Counted(method, name, size, count(net, *size))
