"""UPFlow: photometric and census loss with boundary-dilated warping, and distillation into every level."""

from __future__ import annotations

from torch import Tensor

from ..data.loader import Batch, WholeFrames
from ..losses.dilated_warp import dilated_warp
from ..losses.upflow import OneWay, upflow_terms
from ..networks import TrainedNetwork
from ..objectives import UpflowObjective
from ..recipe import Recipe
from .objective import LabelFree, TrainingStep


class Upflow(LabelFree):
    """The objective of Luo et al., CVPR 2021."""

    def __init__(self, network: TrainedNetwork, recipe: Recipe, settings: UpflowObjective) -> None:
        super().__init__(network, recipe)
        self._settings = settings

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, Tensor]]:
        """Compute the loss, see `LabelFree.forward`."""
        assert batch.whole is not None, "the loader must provide the uncropped frames"
        first, second = self.images(batch.image1), self.images(batch.image2)
        flows = self.both(first, second)
        seen_first, seen_second = flows.visible()
        forward, backward = flows.forward.float(), flows.backward.float()
        ways = [
            OneWay(
                forward,
                [level[0].float() for level in flows.levels],
                first,
                self._fetched(batch.whole, batch.whole.image2, forward),
                seen_first.float(),
            ),
            OneWay(
                backward,
                [level[1].float() for level in flows.levels],
                second,
                self._fetched(batch.whole, batch.whole.image1, backward),
                seen_second.float(),
            ),
        ]
        terms = upflow_terms(ways, self._settings)
        loss = terms["photometric"] + terms["census"] + terms["smoothness"] + terms["distillation"]
        return loss, {"flow": forward, **terms}

    def _fetched(self, whole: WholeFrames, values: Tensor, flow: Tensor) -> Tensor:
        return dilated_warp(self.images(values), flow, whole.corners, whole.sizes)[0]
