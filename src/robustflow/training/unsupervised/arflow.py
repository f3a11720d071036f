"""ARFlow: a first pass is trained with the photometric loss, and its flow is the label for a second, transformed
pass."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from ...random.rng import Rng, key_of
from ..augmentation.affine import draw_moves, moved, moved_flow
from ..data.loader import Batch
from ..draws import with_noise
from ..losses.unsupervised import UnsupervisedLoss, unsupervised_loss
from ..networks import TrainedNetwork
from ..objectives import ArflowObjective
from ..recipe import Recipe
from .objective import LabelFree, TrainingStep


class Arflow(LabelFree):
    """The objective of Liu et al., "Learning by Analogy", CVPR 2020. The original multiplies the loss by 1024 and the
    gradients by 1/1024, which has no effect in fp32.
    """

    def __init__(self, network: TrainedNetwork, recipe: Recipe, settings: ArflowObjective) -> None:
        super().__init__(network, recipe)
        self._settings = settings

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, Tensor]]:
        """Compute the loss, see `LabelFree.forward`."""
        first, second = self.images(batch.image1), self.images(batch.image2)
        forward, backward = ([flow.float() for flow in flows] for flows in self.both(first, second))
        terms = unsupervised_loss(forward, backward, first, second, self._weights(step))
        loss = terms.total
        numbers = {"flow": forward[0], "photometric": terms.photometric, "smoothness": terms.smoothness}
        if self._settings.self_supervision:
            assert batch.changed is not None, "the loader must provide the frames of the second pass"
            changed = (self.images(batch.changed[0]), self.images(batch.changed[1]))
            supervision = self._second_pass(changed, forward[0].detach(), terms.seen, step)
            loss = loss + self._settings.self_supervision * supervision
            numbers["self_supervision"] = supervision
        return loss, numbers

    def _weights(self, step: TrainingStep) -> UnsupervisedLoss:
        settings = self._settings
        raw = UnsupervisedLoss(smooth=settings.smooth, second_order=settings.second_order)
        if step.progress < settings.census_from:
            return raw
        return replace(raw, l1=0.0, ssim=0.0, census=1.0, splat=False)

    def _second_pass(self, images: tuple[Tensor, Tensor], flow: Tensor, seen: Tensor, step: TrainingStep) -> Tensor:
        """Return the distance between the flow of the transformed frames and the transformed flow, where the first
        frame is not occluded."""
        settings, (height, width) = self._settings.spatial, flow.shape[2:]
        moves = [
            draw_moves(Rng.of(step.seed, "moves", position), settings, (height, width)) for position in step.positions
        ]
        first, second = moved(images[0], [one.first for one in moves]), moved(images[1], [one.second for one in moves])
        wanted, mask = moved_flow(flow, moves), moved(seen, [one.first for one in moves])
        deviation = Rng.of(step.seed, "second pass noise", step.number).uniform(0.0, settings.noise)
        first, second = (
            with_noise(image, deviation, [key_of(step.seed, "second pass", at, which) for at in step.positions], 1.0)
            for which, image in enumerate((first, second))
        )
        with self.autocast(first):
            flows = self.network.net(first, second)
        return ((flows.float() - wanted).abs() * mask).mean() / (mask.mean() + 1e-7)
