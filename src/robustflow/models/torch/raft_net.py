"""Wrap torchvision's RAFT in the interface of the project's networks."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn


class TorchvisionRaft(nn.Module):
    """torchvision's RAFT with its input transform; returns only the last flow."""

    def __init__(self, model: Any, iterations: int) -> None:
        super().__init__()
        self.model = model
        self.iterations = iterations

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Predict the flow (N, 2, H, W) in pixels from RGB images (N, 3, H, W) in 0..255."""
        return self.predictions(image1, image2)[-1]

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after every iteration, for the loss."""
        first, second = ((image.contiguous() / 255 - 0.5) / 0.5 for image in (image1, image2))
        flows: list[Tensor] = self.model(first, second, num_flow_updates=self.iterations)
        return flows
