"""Backward warping, and the convolutional blocks of the PWC family (Sun et al. 2018) for ARFlow and UPFlow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .correlation import pixel_grid


def warp(maps: Tensor, flow: Tensor, padding: str = "zeros", align_corners: bool = True) -> Tensor:
    """Sample `maps` bilinearly at pixel + flow."""
    height, width = maps.shape[2:]
    with torch.autocast(maps.device.type, enabled=False):
        x, y = (pixel_grid(maps) + flow.float()).unbind(dim=1)
        grid = torch.stack((2 * x / max(width - 1, 1) - 1, 2 * y / max(height - 1, 1) - 1), dim=-1)
        return F.grid_sample(maps.float(), grid, mode="bilinear", padding_mode=padding, align_corners=align_corners)


def inside_mask(flow: Tensor, threshold: float, align_corners: bool = True) -> Tensor:
    """Return 1 where the bilinear weights inside the map sum to at least `threshold`, otherwise 0."""
    ones = torch.ones_like(flow[:, :1], dtype=torch.float32)
    return (warp(ones, flow, align_corners=align_corners) >= threshold).float()


def leaves(flow: Tensor) -> Tensor:
    """Return a mask of the pixels whose flow (N, 2, H, W), in pixels, points outside the map, bool (N, 1, H, W)."""
    height, width = flow.shape[2:]
    x, y = (pixel_grid(flow) + flow).split(1, dim=1)
    return (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)


def conv(
    inputs: int, outputs: int, kernel: int = 3, stride: int = 1, dilation: int = 1, linear: bool = False
) -> nn.Sequential:
    """Build a convolution that keeps the size (up to its stride), with LeakyReLU(0.1) unless `linear`."""
    padding = (kernel - 1) // 2 * dilation
    layers: list[nn.Module] = [nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation)]
    return nn.Sequential(*layers if linear else [*layers, nn.LeakyReLU(0.1)])


class FeaturePyramid(nn.Module):
    """A feature pyramid with two convolutions per level, the first with stride 2."""

    def __init__(self, channels: Sequence[int]) -> None:
        super().__init__()
        self.convs = nn.ModuleList(
            nn.Sequential(conv(before, after, stride=2), conv(after, after)) for before, after in pairwise(channels)
        )

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return the levels of an image (N, 3, H, W), finest (1/2) first."""
        levels = [image]
        for level in self.convs:
            levels.append(level(levels[-1]))
        return levels[1:]


class ContextNetwork(nn.Module):
    """A context network of seven dilated convolutions that returns a flow residual."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        widths = (inputs, 128, 128, 128, 96, 64, 32)
        dilations = (1, 2, 4, 8, 16, 1)
        layers = [
            conv(before, after, dilation=dilation)
            for before, after, dilation in zip(widths[:-1], widths[1:], dilations, strict=True)
        ]
        self.convs = nn.Sequential(*layers, conv(widths[-1], 2, linear=True))

    def forward(self, features: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, 2, H, W), in pixels of this level."""
        return self.convs(features)


class DenseEstimator(nn.Module):
    """A densely connected block of five convolutions and a final linear convolution."""

    def __init__(self, inputs: int, widths: Sequence[int], outputs: int) -> None:
        super().__init__()
        for i, width in enumerate(widths, 1):
            self.add_module(f"conv{i}", conv(inputs, width))
            inputs += width
        self.conv_last = conv(inputs, outputs, linear=True)
        self.channels = inputs

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return all features, most recent first, (N, channels, H, W), and the output (N, outputs, H, W)."""
        for step in (self.conv1, self.conv2, self.conv3, self.conv4, self.conv5):
            features = torch.cat((step(features), features), dim=1)
        return features, self.conv_last(features)
