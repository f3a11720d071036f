"""RAFT's feature encoder (Teed and Deng 2020, section 3.1) with instance normalisation."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """A residual block: two 3 x 3 convolutions with a shortcut connection."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride)) if stride > 1 else None

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, outputs, H / stride, W / stride), rounded up."""
        y = F.relu(F.instance_norm(self.conv1(x)))
        y = F.relu(F.instance_norm(self.conv2(y)))
        if self.downsample is not None:
            x = F.instance_norm(self.downsample(x))
        return F.relu(x + y)


class ResidualEncoder(nn.Module):
    """RAFT's encoder: a 7 x 7 convolution with stride 2, three stages with two residual blocks each, and a 1 x 1
    convolution.
    """

    def __init__(self, outputs: int = 256, inputs: int = 3) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, 64, 7, stride=2, padding=3)
        self.layer1 = nn.Sequential(ResidualBlock(64, 64, 1), ResidualBlock(64, 64, 1))
        self.layer2 = nn.Sequential(ResidualBlock(64, 96, 2), ResidualBlock(96, 96, 1))
        self.layer3 = nn.Sequential(ResidualBlock(96, 128, 2), ResidualBlock(128, 128, 1))
        self.conv2 = nn.Conv2d(128, outputs, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Map images (N, inputs, H, W) in -1..1 to (N, outputs, H / 8, W / 8)."""
        x = F.relu(F.instance_norm(self.conv1(image)))
        return self.conv2(self.layer3(self.layer2(self.layer1(x))))
