"""ARFlow's network, PWC-lite (Liu et al., "Learning by Analogy", CVPR 2020), for two frames."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..torch.network_model import resize_flow
from .blocks.correlation import WINDOW, local_correlation
from .blocks.pwc import ContextNetwork, FeaturePyramid, conv, warp


class ReducedDenseEstimator(nn.Module):
    """The decoder of a level; each layer receives the outputs of the two previous layers."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.conv1 = conv(inputs, 128)
        self.conv2 = conv(128, 128)
        self.conv3 = conv(128 + 128, 96)
        self.conv4 = conv(128 + 96, 64)
        self.conv5 = conv(96 + 64, 32)
        self.predict_flow = conv(64 + 32, 2, linear=True)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the last features (N, 32, H, W) and the residual (N, 2, H, W) in pixels of this level."""
        c1 = self.conv1(inputs)
        c2 = self.conv2(c1)
        c3 = self.conv3(torch.cat((c1, c2), dim=1))
        c4 = self.conv4(torch.cat((c2, c3), dim=1))
        c5 = self.conv5(torch.cat((c3, c4), dim=1))
        return c5, self.predict_flow(torch.cat((c4, c5), dim=1))


class ARFlow(nn.Module):
    """PWC-lite: one coarse-to-fine pass over five levels with one decoder."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_pyramid_extractor = FeaturePyramid((3, 16, 32, 64, 96, 128, 192))
        self.flow_estimators = ReducedDenseEstimator(WINDOW + 32 + 2)
        self.context_networks = ContextNetwork(32 + 2)
        self.conv_1x1 = nn.ModuleList(conv(channels, 32, kernel=1) for channels in (192, 128, 96, 64, 32))

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Return the flow from image 1 to image 2, (N, 2, H, W) in pixels."""
        return self.flows(self.features(image1), self.features(image2))[0]

    def both(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return the flows in both directions for each level, in the format of `flows`."""
        features1, features2 = self.features(image1), self.features(image2)
        return self.flows(features1, features2), self.flows(features2, features1)

    def features(self, image: Tensor) -> list[Tensor]:
        """Return the feature pyramid of an image, finest level (1/2) first."""
        return self.feature_pyramid_extractor(image)

    def flows(self, features1: list[Tensor], features2: list[Tensor]) -> list[Tensor]:
        """Return one flow per level, finest first, each at four times the size of its level."""
        coarse_to_fine = list(zip(features1[:0:-1], features2[:0:-1], self.conv_1x1, strict=True))
        flow = torch.zeros_like(coarse_to_fine[0][0][:, :2], dtype=torch.float32)
        flows = []
        for level, (own, other, reduce) in enumerate(coarse_to_fine):
            if level:
                flow = resize_flow(flow, tuple(own.shape[2:]))
                other = warp(other, flow, padding="border")
            correlation = F.leaky_relu(local_correlation(own, other), 0.1)
            last, residual = self.flow_estimators(torch.cat((correlation, reduce(own), flow), dim=1))
            flow = flow + residual
            flow = flow + self.context_networks(torch.cat((last, flow), dim=1))
            flows.append(resize_flow(flow, (4 * flow.shape[2], 4 * flow.shape[3])))
        return flows[::-1]
