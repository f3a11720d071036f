"""UPFlow's network (Luo et al., "UPFlow: Upsampling Pyramid for Unsupervised Optical Flow Learning", CVPR 2021)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...core.errors import ModelError
from ..torch.network_model import resize, resize_flow
from .blocks.correlation import WINDOW, local_correlation
from .blocks.pwc import ContextNetwork, DenseEstimator, FeaturePyramid, conv, inside_mask, leaves, warp


@dataclass(frozen=True)
class BothFlows:
    """The result of one pass over a pair."""

    forward: Tensor
    backward: Tensor
    levels: list[tuple[Tensor, Tensor]]

    def visible(self) -> tuple[Tensor, Tensor]:
        """Masks of the pixels of image 1 visible in image 2, and vice versa, bool (N, 1, H, W) each; see `visible`."""
        return visible(self.forward, self.backward), visible(self.backward, self.forward)


@dataclass(frozen=True)
class Sampling:
    """Sampling settings of the network's warps; their effect differs between PyTorch versions and machines."""

    align_corners: bool
    threshold: float

    def masked(self, maps: Tensor, flow: Tensor) -> Tensor:
        """Warp `maps` along `flow`, with zeros where the flow points outside the map."""
        return self.plain(maps, flow) * inside_mask(flow, self.threshold, self.align_corners)

    def plain(self, maps: Tensor, flow: Tensor) -> Tensor:
        """Warp `maps` along `flow`; values fade to zero within one pixel outside the border."""
        return warp(maps, flow, align_corners=self.align_corners)


class SelfGuidedUpsampler(nn.Module):
    """Correct an upsampled flow: a pixel can copy the flow of the position that an interpolation flow names."""

    def __init__(self, sampling: Sampling) -> None:
        super().__init__()
        self.sampling = sampling
        self.dense_estimator_mask = DenseEstimator(64, (32, 32, 32, 16, 8), 3)
        self.upsample_output_conv = nn.Sequential(
            conv(3, 16), conv(16, 16, stride=2), conv(16, 32), conv(32, 32, stride=2)
        )

    def forward(self, flow: Tensor, own: Tensor, other: Tensor, target: Tensor | None = None) -> Tensor:
        """Return the corrected flow, with the size of `target` if it is given."""
        both = torch.cat((own, self.sampling.masked(other, flow)), dim=1)
        between, logit = self.dense_estimator_mask(both)[1].split((2, 1), dim=1)
        keep = torch.sigmoid(logit)
        if target is not None:
            size = tuple(target.shape[2:])
            flow, between, keep = target, resize_flow(between, size), resize(keep, size)
        return self.sampling.plain(flow, between) * (1 - keep) + flow * keep


class UPFlow(nn.Module):
    """UPFlow, which predicts both directions in one coarse-to-fine pass over five levels."""

    def __init__(self, align_corners: bool = True, mask_threshold: float = 0.9999) -> None:
        super().__init__()
        self.sampling = Sampling(align_corners, mask_threshold)
        self.feature_pyramid_extractor = FeaturePyramid((3, 16, 32, 64, 96, 128, 196))
        self.flow_estimators = DenseEstimator(WINDOW + 32 + 2, (128, 128, 96, 64, 32), 2)
        self.context_networks = ContextNetwork(self.flow_estimators.channels + 2)
        self.conv_1x1 = nn.ModuleList(conv(channels, 32, kernel=1) for channels in (196, 128, 96, 64, 32))
        self.sgi_model = SelfGuidedUpsampler(self.sampling)

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Return the flow from image 1 to image 2, (N, 2, H, W) in pixels."""
        return self.both(image1, image2).forward

    def both(self, image1: Tensor, image2: Tensor) -> BothFlows:
        """Return the flows in both directions, at full size and for each level."""
        if max(image1.shape[2:]) <= 64:
            height, width = image1.shape[2:]
            raise ModelError(f"{height}x{width}", "upflow needs frames wider or taller than 64 pixels")
        features1, features2 = (self.feature_pyramid_extractor(image)[:0:-1] for image in (image1, image2))
        forward = backward = torch.zeros_like(features1[0][:, :2], dtype=torch.float32)
        levels = []
        for level, (f1, f2, reduce) in enumerate(zip(features1, features2, self.conv_1x1, strict=True)):
            r1, r2 = reduce(f1), reduce(f2)
            if level:
                size = tuple(f1.shape[2:])
                forward = self.sgi_model(resize_flow(forward, size), r1, r2)
                backward = self.sgi_model(resize_flow(backward, size), r2, r1)
                forward, backward = (
                    self._decode(f1, self.sampling.masked(f2, forward), r1, forward),
                    self._decode(f2, self.sampling.masked(f1, backward), r2, backward),
                )
            else:
                forward, backward = self._decode(f1, f2, r1, forward), self._decode(f2, f1, r2, backward)
            levels.append((forward, backward))
        size = tuple(image1.shape[2:])
        g1, g2 = (self.sgi_model.upsample_output_conv(image) for image in (image1, image2))
        return BothFlows(
            self.sgi_model(forward, g1, g2, target=resize_flow(forward, size)),
            self.sgi_model(backward, g2, g1, target=resize_flow(backward, size)),
            levels,
        )

    def _decode(self, own: Tensor, other: Tensor, reduced: Tensor, flow: Tensor) -> Tensor:
        correlation = F.leaky_relu(local_correlation(_normalised(own), _normalised(other)), 0.1)
        features, residual = self.flow_estimators(torch.cat((correlation, reduced, flow), dim=1))
        flow = flow + residual
        return flow + self.context_networks(torch.cat((features, flow), dim=1))


def _normalised(features: Tensor) -> Tensor:
    """Normalise to zero mean and unit variance over the pixels, per image and channel."""
    features = features.float()
    mean = features.mean(dim=(2, 3), keepdim=True)
    variance = features.var(dim=(2, 3), keepdim=True)
    return (features - mean) / torch.sqrt(variance + 1e-16)


def visible(flow: Tensor, other: Tensor) -> Tensor:
    """Return a mask of the pixels where the forward and backward flows agree, or that leave the frame."""
    difference = (flow + warp(other, flow)).abs().sum(dim=1, keepdim=True)
    bound = 0.1 * (flow.abs().sum(dim=1, keepdim=True) + other.abs().sum(dim=1, keepdim=True)) + 0.5
    return torch.logical_or(difference < bound, leaves(flow))
