"""BrightFlow's brightness corrector, a network used only during training (Marsal et al., WACV 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..models.networks.blocks.convex_upsample import convex_upsample, mask_layers
from ..models.networks.residual_encoder import ResidualEncoder

_FEATURES = 128


class Corrector(ResidualEncoder):
    """Predict colour offsets for an image from the image, the second image warped to it by the flow, and a visibility
    mask.
    """

    def __init__(self) -> None:
        super().__init__(_FEATURES, inputs=7)
        self.offset_head = nn.ModuleDict(
            {"conv1": nn.Conv2d(_FEATURES, 256, 3, padding=1), "conv2": nn.Conv2d(256, 3, 3, padding=1)}
        )
        self.mask = mask_layers()

    def forward(self, image: Tensor) -> Tensor:
        """Return colour offsets (N, 3, H, W), -1..1 as fractions of the image's range."""
        features = super().forward(image)
        offsets = torch.tanh(self.offset_head["conv2"](torch.relu(self.offset_head["conv1"](features))))
        return convex_upsample(offsets / 8, 0.25 * self.mask(features), 8)
