"""A network with the loss of its recipe, as one module."""

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
    """The loss as a function of the weights; `DistributedDataParallel` wraps this module, and so supports any loss.

    Args:
        network: to be trained.
        recipe: gives precision and loss.

    Raises:
        UsageError: a crop that a method without labels cannot take.
    """

    def __init__(self, network: TrainedNetwork, recipe: Recipe) -> None:
        super().__init__()
        self.network = network
        self._recipe = recipe
        self._objective = None if recipe.objective is None else build_objective(network, recipe)

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, float]]:
        """See `loss_of_batch`, and for a recipe without labels `LabelFree`, which logs EPE where the data have ground
        truth."""
        if self._objective is None:
            return loss_of_batch(self.network, batch, self._recipe)
        loss, terms = self._objective(batch, step)
        flow = terms.pop("flow").detach()
        numbers = {name: value.item() for name, value in terms.items()}
        error = end_point_error(flow, batch.flow, batch.valid).item()
        return loss, numbers if math.isnan(error) else {**numbers, "epe": error}
