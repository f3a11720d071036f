"""The parts of RAFT's update block that later networks share (Teed and Deng 2020, section 3.3)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class MotionEncoder(nn.Module):
    """The encoder of correlation and flow to 128 channels, the last two of which are the flow."""

    def __init__(self, correlation: int) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(correlation, 256, 1)
        self.convc2 = nn.Conv2d(256, 192, 3, padding=1)
        self.convf1 = nn.Conv2d(2, 128, 7, padding=3)
        self.convf2 = nn.Conv2d(128, 64, 3, padding=1)
        self.conv = nn.Conv2d(192 + 64, 128 - 2, 3, padding=1)

    def forward(self, flow: Tensor, correlation: Tensor) -> Tensor:
        """Map a flow (N, 2, H, W), in pixels of this resolution, and correlations (N, correlation, H, W) to (N, 128, H,
        W).
        """
        correlation_features = F.relu(self.convc2(F.relu(self.convc1(correlation))))
        moved = F.relu(self.convf2(F.relu(self.convf1(flow))))
        return torch.cat((F.relu(self.conv(torch.cat((correlation_features, moved), dim=1))), flow), dim=1)


class FlowHead(nn.Module):
    """The head that maps a state to a flow residual in pixels of the state's resolution."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(128, 256, 3, padding=1)
        self.conv2 = nn.Conv2d(256, 2, 3, padding=1)

    def forward(self, state: Tensor) -> Tensor:
        """Map (N, 128, H, W) to (N, 2, H, W)."""
        return self.conv2(F.relu(self.conv1(state)))
