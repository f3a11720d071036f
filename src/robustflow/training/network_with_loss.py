"""Combine a network with the loss of its recipe in one module."""

from __future__ import annotations

import math

from torch import Tensor, nn

from .data.loader import Batch
from .loss_of_batch import loss_of_batch
from .losses.sequence import end_point_error
from .networks import TrainedNetwork
from .recipe import Recipe
from .unsupervised.build import build_objective
from .unsupervised.objective import TrainingStep


class NetworkWithLoss(nn.Module):
    """A module that computes the loss. `DistributedDataParallel` wraps this module, so it supports any loss.

    Args:
        network: network to train.
        recipe: recipe, which defines precision and loss.

    Raises:
        UsageError: a method without labels does not support the crop.
    """

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
