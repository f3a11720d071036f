"""BrightFlow's network at inference (Marsal et al., WACV 2023): RAFT with instance normalisation in both encoders."""

from __future__ import annotations

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.correlation import CorrelationPyramid, pixel_grid
from .blocks.raft import FlowHead, MotionEncoder, SepConvGRU, convex_upsample, mask_layers

LEVELS, RADIUS = 4, 4
HIDDEN = CONTEXT = 128


class UpdateBlock(nn.Module):
    """One recurrent update and the mask that upsamples its flow."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = MotionEncoder(LEVELS * (2 * RADIUS + 1) ** 2)
        self.gru = SepConvGRU(HIDDEN, CONTEXT + 128)
        self.flow_head = FlowHead()
        self.mask = mask_layers()

    def forward(self, state: Tensor, context: Tensor, correlation: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return the new state (N, 128, H, W) and the flow residual (N, 2, H, W), in pixels of this resolution."""
        motion = self.encoder(flow, correlation)
        state = self.gru(state, torch.cat((context, motion), dim=1))
        return state, self.flow_head(state)


class BrightFlow(nn.Module):
    """RAFT trained without labels. The brightness corrector that gave the method its name is used only in training."""

    def __init__(self, iterations: int = 12) -> None:
        super().__init__()
        self.iterations = iterations
        self.model = nn.ModuleDict(
            {"fnet": ResidualEncoder(), "cnet": ResidualEncoder(HIDDEN + CONTEXT), "update_block": UpdateBlock()}
        )

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Return the flow from image 1 to image 2 after the last iteration, (N, 2, H, W) in pixels."""
        for flow, state in self._iterate(image1, image2):
            last = flow, state
        return self._enlarge(*last)

    def flows(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after each iteration, (N, 2, H, W) in pixels."""
        return [self._enlarge(flow, state) for flow, state in self._iterate(image1, image2)]

    def both(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return the flows in both directions after each iteration."""
        return self.flows(image1, image2), self.flows(image2, image1)

    def _iterate(self, image1: Tensor, image2: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        features1, features2 = self.model["fnet"](image1), self.model["fnet"](image2)
        state, context = self.model["cnet"](image1).split((HIDDEN, CONTEXT), dim=1)
        state, context = torch.tanh(state), torch.relu(context)
        correlation = CorrelationPyramid(features1, features2, LEVELS, RADIUS)
        origin = target = pixel_grid(features1)
        for _ in range(self.iterations):
            state, residual = self.model["update_block"](state, context, correlation.lookup(target), target - origin)
            target = target + residual
            yield target - origin, state

    def _enlarge(self, flow: Tensor, state: Tensor) -> Tensor:
        # The logits are divided by four, as in RAFT, to balance the gradients in training.
        return convex_upsample(flow, 0.25 * self.model["update_block"].mask(state), 8)


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
    """RAFT's encoder: a 7 x 7 convolution, three stages of two residual blocks, a 1 x 1 convolution."""

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
