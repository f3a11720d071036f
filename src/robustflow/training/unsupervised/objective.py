"""The loss of a batch for methods that learn without labels, as a module that the training loop calls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from ...errors import UsageError
from ...models.torch.fit import fitted_values
from ..data.loader import Batch
from ..networks import TrainedNetwork, mixed_precision
from ..recipe import Recipe


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
                f"crop {recipe.crop[0]}x{recipe.crop[1]}: {recipe.method} needs multiples of {multiple}; choose a "
                "different --crop"
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
