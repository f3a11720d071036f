"""Wrap torchvision's RAFT so that it is called like the project's own networks."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn


class TorchvisionRaft(nn.Module):
    """Scales the images as torchvision's transform does and keeps the last of its flows."""

    def __init__(self, model: Any, iterations: int) -> None:
        super().__init__()
        self.model = model
        self.iterations = iterations

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Images (N, 3, H, W), RGB, 0..255, to flow (N, 2, H, W) in pixels."""
        return self.predictions(image1, image2)[-1]

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """The flow after every iteration, for the loss."""
        first, second = ((image.contiguous() / 255 - 0.5) / 0.5 for image in (image1, image2))
        flows: list[Tensor] = self.model(first, second, num_flow_updates=self.iterations)
        return flows
