"""Compute the loss of a batch as defined by a recipe."""

from __future__ import annotations

import torch
from torch import Tensor

from .data.loader import Batch
from .losses.matching import MATCHING_WEIGHT, matching_loss
from .losses.sequence import end_point_error, sequence_loss
from .networks import TrainedNetwork
from .recipe import Recipe

DTYPES = {"bf16": torch.bfloat16, "fp16": torch.float16}
"""The data type of each mixed-precision mode."""


def loss_of_batch(network: TrainedNetwork, batch: Batch, recipe: Recipe) -> tuple[Tensor, dict[str, float]]:
    """Return the loss to be minimised, and values for the log (EPE of the last prediction, in pixels).

    Args:
        network: network being trained; its method `loss` is used if defined.
        batch: batch on the network's device.
        recipe: recipe, which defines precision and loss.

    Raises:
        UsageError: the network does not support the loss.
    """
    matching: Tensor | None = None
    device = batch.image1.device.type
    with torch.autocast(device, DTYPES.get(recipe.precision), enabled=recipe.precision in DTYPES):
        if network.has_own_loss:
            return network.own_loss(batch)
        if recipe.loss == "denoising":
            assert batch.time is not None
            assert batch.noise is not None
            flows = network.denoised(batch.image1, batch.image2, batch.flow, batch.time, batch.noise)
        elif recipe.loss == "sequence+matching":
            flows, matching = network.matched(batch.image1, batch.image2)
        else:
            flows = network(batch.image1, batch.image2)
    loss = sequence_loss(flows, batch.flow, batch.valid, recipe.gamma)
    numbers = {}
    if matching is not None:
        off = matching_loss(matching.float(), batch.image1, batch.image2, batch.flow)
        loss, numbers["matching"] = loss + MATCHING_WEIGHT * off, off.item()
    with torch.no_grad():
        return loss, {"epe": end_point_error(flows[-1], batch.flow, batch.valid).item(), **numbers}
