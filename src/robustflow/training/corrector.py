"""BrightFlow's brightness corrector, a network needed only for its training (Marsal et al., WACV 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..models.own.blocks.convex_upsample import convex_upsample, mask_layers
from ..models.own.nets.residual_encoder import ResidualEncoder

_FEATURES = 128


class Corrector(nn.Module):
    """From an image, the other image warped to it by the flow, and a visibility mask, to offsets of its colours.

    Written from a description: the encoder of the flow network on seven channels, a head of three at 1/8, and convex
    upsampling. How wide the head is and what its mask is made from is not described.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ResidualEncoder(_FEATURES, inputs=7)
        self.head = nn.Sequential(nn.Conv2d(_FEATURES, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 3, 3, padding=1))
        self.mask = mask_layers(_FEATURES)

    def forward(self, image: Tensor, warped: Tensor, seen: Tensor) -> Tensor:
        """Offsets (N, 3, H, W) in -1..1, which are added to the image.

        Args:
            image, warped: (N, 3, H, W) in -1..1.
            seen: (N, 1, H, W), 1 where the pixel is not occluded.
        """
        features = torch.relu(self.encoder(torch.cat((image, warped, seen), dim=1)))
        return convex_upsample(torch.tanh(self.head(features)) / 8, 0.25 * self.mask(features), 8)
