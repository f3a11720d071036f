"""UPFlow: photometric and census loss with boundary-dilated warping, and distillation into every level."""

from __future__ import annotations

from torch import Tensor

from ..data.loader import Batch
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
        flows, whole = self.both(first, second), batch.whole
        ways = []
        for flow, levels, image, target, seen in zip(
            (flows.forward.float(), flows.backward.float()),
            zip(*flows.levels, strict=True),
            (first, second),
            (whole.image2, whole.image1),
            flows.visible(),
            strict=True,
        ):
            warped, _ = dilated_warp(self.images(target), flow, whole.corners, whole.sizes)
            ways.append(OneWay(flow, [level.float() for level in levels], image, warped, seen.float()))
        terms = upflow_terms(ways, self._settings)
        loss = terms["photometric"] + terms["census"] + terms["smoothness"] + terms["distillation"]
        return loss, {"flow": ways[0].flow, **terms}
