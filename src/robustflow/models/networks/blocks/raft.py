"""Parts of RAFT that later networks share (Teed and Deng 2020, section 3.3): convex upsampling, GRU, motion encoder."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def mask_layers(factor: int = 8) -> nn.Sequential:
    """Build the head from a state (N, 128, H, W) to the logits of `convex_upsample`."""
    return nn.Sequential(nn.Conv2d(128, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 9 * factor * factor, 1))


def convex_upsample(flow: Tensor, mask: Tensor, factor: int = 8) -> Tensor:
    """Upsample a flow with a predicted mask."""
    n, channels, height, width = flow.shape
    weights = mask.float().view(n, 1, 9, factor, factor, height, width).softmax(dim=2)
    neighbours = F.unfold(factor * flow.float(), kernel_size=3, padding=1)
    neighbours = neighbours.view(n, channels, 9, 1, 1, height, width)
    fine = (weights * neighbours).sum(dim=2).permute(0, 1, 4, 2, 5, 3)
    return fine.reshape(n, channels, factor * height, factor * width)


class SepConvGRU(nn.Module):
    """A layer of two GRU steps, along rows and then along columns."""

    def __init__(self, hidden: int = 128, inputs: int = 256) -> None:
        super().__init__()
        for step, kernel, padding in ((1, (1, 5), (0, 2)), (2, (5, 1), (2, 0))):
            for gate in "zrq":
                self.add_module(
                    f"conv{gate}{step}", nn.Conv2d(hidden + inputs, hidden, kernel_size=kernel, padding=padding)
                )

    def forward(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Return the new state (N, hidden, H, W) from the state (N, hidden, H, W) and the input (N, inputs, H, W)."""
        for convz, convr, convq in (
            (self.convz1, self.convr1, self.convq1),
            (self.convz2, self.convr2, self.convq2),
        ):
            both = torch.cat((state, inputs), dim=1)
            update = torch.sigmoid(convz(both))
            reset = torch.sigmoid(convr(both))
            candidate = torch.tanh(convq(torch.cat((reset * state, inputs), dim=1)))
            state = (1 - update) * state + update * candidate
        return state


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
        """Map a flow (N, 2, H, W) and correlations (N, correlation, H, W) to (N, 128, H, W)."""
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
