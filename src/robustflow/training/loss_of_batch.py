"""The loss of one batch under a recipe."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..random.rng import Rng, key_of
from .data.loader import Batch
from .losses.sequence import end_point_error, sequence_loss
from .recipe import Recipe

_DTYPES = {"bf16": torch.bfloat16, "fp16": torch.float16}


def loss_of_batch(network: nn.Module, batch: Batch, recipe: Recipe) -> tuple[Tensor, dict[str, float]]:
    """The loss to be minimised, and numbers for the log (EPE in pixels of the last prediction).

    Args:
        network: a `TrainedNetwork`, or what spreads one over processes.
        batch: on the network's device.
        recipe: says precision and loss.
    """
    device = batch.image1.device.type
    with torch.autocast(device, _DTYPES.get(recipe.precision), enabled=recipe.precision in _DTYPES):
        flows = network(batch.image1, batch.image2)
    loss = sequence_loss(flows, batch.flow, batch.valid, recipe.gamma)
    with torch.no_grad():
        return loss, {"epe": end_point_error(flows[-1], batch.flow, batch.valid).item()}


def noisy(batch: Batch, recipe: Recipe, seed: int, step: int, positions: list[int]) -> Batch:
    """The batch with the recipe's noise on both frames: one standard deviation, uniform from 0 to the largest, for all
    pairs of a step (FlowFormer)."""
    if not recipe.noise:
        return batch
    deviation = Rng.of(seed, "noise", step).uniform(0.0, recipe.noise)
    images = []
    for which, image in enumerate((batch.image1, batch.image2)):
        drawn = [_normal(key_of(seed, "noise", position, which), image[0]) for position in positions]
        images.append((image + deviation * torch.stack(drawn).to(image.device)).clamp(0.0, 255.0))
    return Batch(images[0], images[1], batch.flow, batch.valid, batch.names)


def _normal(key: int, like: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(key % 2**63)
    return torch.randn(like.shape, generator=generator)
