"""The loss of a batch for ARFlow and UPFlow, as a module that the training loop calls.

ARFlow's first pass is trained with the photometric loss, and its flow is the label for a second, transformed pass.
UPFlow uses photometric and census loss with boundary-dilated warping, and distillation into every level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from ...core.errors import UsageError
from ...core.rng import Rng, key_of
from ...models.torch.network_model import fitted_values
from ..augmentation.affine import draw_moves, moved, moved_flow
from ..data.loader import Batch
from ..draws import with_noise
from ..losses.terms import dilated_warp
from ..losses.unsupervised import OneWay, UnsupervisedLoss, unsupervised_loss, upflow_terms
from ..recipe import ArflowObjective, Recipe, UpflowObjective
from ..trained_network import TrainedNetwork, mixed_precision


@dataclass(frozen=True)
class TrainingStep:
    """The step of a training run to which a batch belongs."""

    seed: int
    number: int
    positions: tuple[int, ...]
    progress: float


class LabelFree(nn.Module):
    """Base class of the objectives. `forward` returns the loss and values for the log."""

    def __init__(self, network: TrainedNetwork, recipe: Recipe) -> None:
        super().__init__()
        multiple = network.convention.multiple
        if any(side % multiple for side in recipe.crop):
            raise UsageError(
                "--crop", f"{recipe.crop[0]}x{recipe.crop[1]}: {recipe.method} needs multiples of {multiple}"
            )
        self.network = network
        self._convention = replace(network.convention, fit="none", multiple=1, size=None)
        self._recipe = recipe

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, and values for the log; among these, `flow` is the final flow, (N, 2, H, W), in pixels."""
        raise NotImplementedError

    def images(self, values: Tensor) -> Tensor:
        """Convert RGB images in 0..255 to the network's input format without resizing."""
        return fitted_values(values, self._convention)

    def both(self, image1: Tensor, image2: Tensor) -> Any:
        """Predict the flows of both directions, in the recipe's precision."""
        with self.autocast(image1):
            return self.network.net.both(image1, image2)

    def autocast(self, image: Tensor) -> torch.autocast:
        """Return a context with the recipe's precision."""
        return mixed_precision(image, self._recipe)


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
        first, second = (
            moved(images[0], [move.first for move in moves]),
            moved(images[1], [move.second for move in moves]),
        )
        wanted, mask = moved_flow(flow, moves), moved(seen, [move.first for move in moves])
        deviation = Rng.of(step.seed, "second pass noise", step.number).uniform(0.0, settings.noise)
        first, second = (
            with_noise(image, deviation, [key_of(step.seed, "second pass", at, which) for at in step.positions], 1.0)
            for which, image in enumerate((first, second))
        )
        with self.autocast(first):
            flows = self.network.net(first, second)
        return ((flows.float() - wanted).abs() * mask).mean() / (mask.mean() + 1e-7)


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
