"""Compute the loss of a batch as defined by a recipe, in one module with the network."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ..core.errors import UsageError
from .data.loader import Batch
from .losses.supervised import MATCHING_WEIGHT, end_point_error, matching_loss, sequence_loss
from .recipe import ArflowObjective, BrightflowObjective, Recipe, UpflowObjective
from .trained_network import TrainedNetwork, mixed_precision
from .unsupervised.brightflow import Brightflow
from .unsupervised.methods import Arflow, LabelFree, TrainingStep, Upflow


class NetworkWithLoss(nn.Module):
    """A module that computes the loss. `DistributedDataParallel` wraps this module, so it supports any loss."""

    def __init__(self, network: TrainedNetwork, recipe: Recipe) -> None:
        super().__init__()
        self.network = network
        self._recipe = recipe
        self._objective = None if recipe.objective is None else build_objective(network, recipe)

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss with `loss_of_batch`, or with `LabelFree` for a recipe without labels, which logs EPE if the
        data have ground truth."""
        if self._objective is None:
            return loss_of_batch(self.network, batch, self._recipe)
        loss, terms = self._objective(batch, step)
        flow = terms.pop("flow").detach()
        numbers = {name: value.item() for name, value in terms.items()}
        error = end_point_error(flow, batch.flow, batch.valid).item()
        return loss, numbers if math.isnan(error) else {**numbers, "epe": error}


def build_objective(network: TrainedNetwork, recipe: Recipe) -> LabelFree:
    """Return the module that computes the loss of a recipe without labels."""
    settings = recipe.objective
    if isinstance(settings, ArflowObjective):
        return Arflow(network, recipe, settings)
    if isinstance(settings, BrightflowObjective):
        if min(recipe.crop) <= 2 * settings.border:
            raise UsageError(
                "--crop",
                f"{recipe.crop[0]}x{recipe.crop[1]}: brightflow's student does not use the outer "
                f"{settings.border} pixels of the crop, so each side must be longer than {2 * settings.border}; use a "
                "larger --crop",
            )
        return Brightflow(network, recipe, settings)
    assert isinstance(settings, UpflowObjective)
    return Upflow(network, recipe, settings)


def loss_of_batch(network: TrainedNetwork, batch: Batch, recipe: Recipe) -> tuple[Tensor, dict[str, float]]:
    """Return the loss to be minimised, and values for the log (EPE of the last prediction, in pixels)."""
    matching: Tensor | None = None
    with mixed_precision(batch.image1, recipe):
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
