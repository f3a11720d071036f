"""A network with the loss of its recipe, as one module."""

from __future__ import annotations

from torch import Tensor, nn

from .data.loader import Batch
from .loss_of_batch import loss_of_batch
from .networks import TrainedNetwork
from .recipe import Recipe


class NetworkWithLoss(nn.Module):
    """The loss as a function of the weights; what spreads a training over processes wraps this, and so sees any loss.

    Args:
        network: that learns.
        recipe: says precision and loss.
    """

    def __init__(self, network: TrainedNetwork, recipe: Recipe) -> None:
        super().__init__()
        self.network = network
        self._recipe = recipe

    def forward(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """See `loss_of_batch`."""
        return loss_of_batch(self.network, batch, self._recipe)
