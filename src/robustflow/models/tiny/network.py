"""The project's own small network: a feature pyramid, a local correlation and one decoder for all levels.

It belongs to the PWC family (Sun et al. 2018, with the shared decoder of Liu et al. 2020). With 0.38 million
parameters, it is small enough for its weights to be shipped in the package. `models/tiny/` implements it without
PyTorch.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..networks.blocks.correlation import local_correlation
from ..networks.blocks.pwc import FeaturePyramid, conv, warp
from ..networks.blocks.raft import convex_upsample
from ..torch.network_model import resize_flow
from .layers import CHANNELS, DECODER, EPSILON, FINEST, RADIUS, REDUCED


class Tiny(nn.Module):
    """The small network for RGB images in -1..1, float (N, 3, H, W), H and W multiples of 32."""

    def __init__(self) -> None:
        super().__init__()
        self.pyramid = FeaturePyramid(CHANNELS)
        self.reduce = nn.ModuleList(conv(channels, REDUCED, kernel=1) for channels in CHANNELS[:1:-1])
        inputs, layers = (2 * RADIUS + 1) ** 2 + REDUCED + 2, []
        for outputs, dilation in DECODER:
            layers.append(conv(inputs, outputs, dilation=dilation))
            inputs = outputs
        self.decoder = nn.Sequential(*layers)
        self.flow = conv(inputs, 2, linear=True)
        self.mask = conv(inputs, 9 * FINEST * FINEST, kernel=1, linear=True)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):  # with PyTorch's default initialisation, the biases would dominate
                nn.init.kaiming_normal_(layer.weight, 0.1, nonlinearity="leaky_relu")
                nn.init.zeros_(layer.bias)
        self.flow[0].weight.data.mul_(0.1)

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Return the flow from image 1 to image 2, (N, 2, H, W) in pixels."""
        return self.predictions(image1, image2)[-1]

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow of every level at full size, coarsest first, (N, 2, H, W) each, in pixels."""
        size = (image1.shape[2], image1.shape[3])
        levels = list(zip(self.pyramid(image1)[:0:-1], self.pyramid(image2)[:0:-1], self.reduce, strict=True))
        flow = torch.zeros_like(levels[0][0][:, :2])
        flows = []
        for own, other, reduce in levels:
            flow = resize_flow(flow, (own.shape[2], own.shape[3]))
            other = warp(other, flow, padding="border")
            correlation = local_correlation(_normalised(own), _normalised(other), RADIUS)
            hidden = self.decoder(torch.cat((correlation, reduce(own), flow), dim=1))
            flow = flow + self.flow(hidden)
            flows.append(flow)
        fine = convex_upsample(flow, self.mask(hidden), FINEST)
        return [*(resize_flow(flow, size) for flow in flows), fine]


def _normalised(features: Tensor) -> Tensor:
    """Normalise features to a mean square of 1 over the channels, so that a correlation is a cosine."""
    return features * torch.rsqrt(features.square().mean(dim=1, keepdim=True) + EPSILON)
