"""What a method that learns without labels minimises on a batch, as a module that the loop calls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from ...errors import UsageError
from ...models.torch.fit import fitted_values
from ..data.loader import Batch
from ..loss_of_batch import DTYPES
from ..networks import TrainedNetwork
from ..recipe import Recipe


@dataclass(frozen=True)
class TrainingStep:
    """Which step of a training a batch belongs to.

    Attributes:
        seed: of every draw.
        number: of the step, from 0.
        positions: of the batch's pairs, see `Share`.
        progress: fraction of the training's updates made so far, 0 to 1.
    """

    seed: int
    number: int
    positions: tuple[int, ...]
    progress: float


class LabelFree(nn.Module):
    """Base: a network's images and its flows. `forward` gives the loss and numbers for the log.

    Args:
        network: to be trained; its net has a method `both(image1, image2)` that returns the flows of both directions.
        recipe: with an objective.

    Raises:
        UsageError: a network without such a method, or a crop that it cannot take.
    """

    def __init__(self, network: TrainedNetwork, recipe: Recipe) -> None:
        super().__init__()
        multiple = network.convention.multiple
        if any(side % multiple for side in recipe.crop):
            raise UsageError(
                f"crop {recipe.crop[0]}x{recipe.crop[1]}: {recipe.method} trains on multiples of {multiple}; give "
                "another --crop"
            )
        self.network = network
        self._convention = replace(network.convention, fit="none", multiple=1, size=None)
        self._precision = recipe.precision

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and numbers for the log; `flow` among them is the final flow, (N, 2, H, W)."""
        raise NotImplementedError

    def images(self, values: Tensor) -> Tensor:
        """RGB values 0..255 as the network takes them, at their own size."""
        return fitted_values(values, self._convention)

    def both(self, image1: Tensor, image2: Tensor) -> Any:
        """The net's flows of both directions, in the recipe's precision."""
        with self.autocast(image1):
            return self.network.net.both(image1, image2)

    def autocast(self, image: Tensor) -> torch.autocast:
        """The recipe's precision."""
        return torch.autocast(image.device.type, DTYPES.get(self._precision), enabled=self._precision in DTYPES)
