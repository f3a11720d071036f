"""The loss of one batch under a recipe."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor, nn

from ..random.rng import Rng
from .data.loader import Batch
from .losses.sequence import end_point_error, sequence_loss
from .noise import normal
from .recipe import Recipe
from .unsupervised.objective import DTYPES, Moment


def loss_of_batch(network: nn.Module, batch: Batch, recipe: Recipe, moment: Moment) -> tuple[Tensor, dict[str, float]]:
    """The loss to be minimised, and numbers for the log (EPE in pixels of the last prediction, where there is truth).

    Args:
        network: a `TrainedNetwork`, for a recipe without labels a `LabelFree`; or what spreads one over processes.
        batch: on the network's device.
        recipe: says precision and loss.
        moment: of the training.
    """
    if recipe.objective is not None:
        return _without_labels(network, batch, moment)
    device = batch.image1.device.type
    with torch.autocast(device, DTYPES.get(recipe.precision), enabled=recipe.precision in DTYPES):
        flows = network(batch.image1, batch.image2)
    loss = sequence_loss(flows, batch.flow, batch.valid, recipe.gamma)
    with torch.no_grad():
        return loss, {"epe": end_point_error(flows[-1], batch.flow, batch.valid).item()}


def _without_labels(objective: nn.Module, batch: Batch, moment: Moment) -> tuple[Tensor, dict[str, float]]:
    loss, numbers = objective(batch, moment)
    flow = numbers.pop("flow").detach()
    logged = {name: value.item() for name, value in numbers.items()}
    error = end_point_error(flow, batch.flow, batch.valid).item()
    return loss, logged if math.isnan(error) else {**logged, "epe": error}


def noisy(batch: Batch, recipe: Recipe, seed: int, step: int, positions: list[int]) -> Batch:
    """The batch with the recipe's noise on both frames: one standard deviation, uniform from 0 to the largest, for all
    pairs of a step (FlowFormer)."""
    if not recipe.noise:
        return batch
    deviation = Rng.of(seed, "noise", step).uniform(0.0, recipe.noise)
    images = []
    for which, image in enumerate((batch.image1, batch.image2)):
        drawn = [normal((seed, "noise", position, which), image[0]) for position in positions]
        images.append((image + deviation * torch.stack(drawn).to(image.device)).clamp(0.0, 255.0))
    return replace(batch, image1=images[0], image2=images[1])
