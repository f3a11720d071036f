"""The decoder of FlowDiffuser (Luo et al., CVPR 2024), built from SKFlow's large-kernel blocks (Sun et al. 2022)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import context_attention, gather
from .blocks.raft import mask_layers


def _widen(channels: int, outputs: int) -> nn.Sequential:
    inner = channels * 3 // 2
    return nn.Sequential(nn.Conv2d(channels, inner, 1), nn.GELU(), nn.Conv2d(inner, outputs, 1))


class Depthwise(nn.Conv2d):
    """A depthwise convolution."""

    def __init__(self, channels: int, kernel: int) -> None:
        super().__init__(channels, channels, kernel, padding=kernel // 2, groups=channels)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, channels, H, W) to the same shape."""
        if self.kernel_size == (1, 1):
            # Equivalent to a depthwise convolution, which would take a third of the network's run time in torch.
            return x * self.weight.view(-1, 1, 1) + self.bias.view(-1, 1, 1)
        return super().forward(x)


class SuperKernel(nn.Module):
    """A large-kernel block: depthwise convolutions of several sizes between pointwise convolutions."""

    def __init__(self, inputs: int, outputs: int, kernels: tuple[int, ...]) -> None:
        super().__init__()
        self.conv_list = nn.ModuleList(Depthwise(inputs, kernel) for kernel in kernels)
        self.ffn1 = _widen(inputs, inputs)
        self.pw = nn.Conv2d(inputs, inputs, 1)
        self.ffn2 = _widen(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, outputs, H, W)."""
        for layer in (self.ffn1, *self.conv_list, self.pw):
            x = F.gelu(x + layer(x))
        return self.ffn2(x)


class MotionEncoder(nn.Module):
    """The encoder of correlation and flow to 128 channels, the last two of which are the flow."""

    def __init__(self, correlation: int = 324) -> None:
        super().__init__()
        kernels = (1, 15)
        self.convc1 = SuperKernel(correlation, 256, kernels)
        self.convc2 = SuperKernel(256, 192, kernels)
        self.convf1 = nn.Conv2d(2, 128, 1)
        self.convf2 = SuperKernel(128, 64, kernels)
        self.conv = SuperKernel(64 + 192, 128 - 2, kernels)

    def forward(self, flow: Tensor, correlation: Tensor) -> Tensor:
        """Map a flow (N, 2, H, W), in pixels of this resolution, and correlations (N, 324, H, W) to (N, 128, H, W)."""
        correlation_features = self.convc2(F.gelu(self.convc1(correlation)))
        moved = self.convf2(self.convf1(flow))
        return torch.cat((self.conv(torch.cat((correlation_features, moved), dim=1)), flow), dim=1)


class Aggregator(nn.Module):
    """Aggregation of motion from pixels with similar context."""

    def __init__(self) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.zeros(1))
        self.to_qk = nn.Conv2d(128, 256, 1, bias=False)
        self.to_v = nn.Conv2d(128, 128, 1, bias=False)

    def attention(self, context: Tensor) -> Tensor:
        """Compute the attention (N, H * W, H * W) from the context (N, 128, H, W), once per image."""
        return context_attention(self.to_qk(context))

    def forward(self, attention: Tensor, motion: Tensor) -> Tensor:
        """Map attention (N, H * W, H * W) and motion features (N, 128, H, W) to (N, 128, H, W)."""
        return motion + self.gamma * gather(attention, self.to_v(motion))


class SkUpdate(nn.Module):
    """A recurrent update of the hidden state."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = MotionEncoder()
        self.gru = SuperKernel(4 * 128, 128, (1, 7))
        self.flow_head = SuperKernel(128, 2, (1, 15))
        self.aggregator = Aggregator()

    def forward(self, net: Tensor, context: Tensor, motion: Tensor, gathered: Tensor) -> Tensor:
        """Return the new state from the state, context, motion and aggregated motion, (N, 128, H, W) each."""
        return self.gru(torch.cat((net, context, motion, gathered), dim=1))


class MaskHead(nn.Module):
    """The head that maps a state to the logits of a convex upsampling, (N, 9 * factor ** 2, H, W)."""

    def __init__(self, factor: int) -> None:
        super().__init__()
        self.up_sample_mask = mask_layers(factor=factor)

    def forward(self, net: Tensor) -> Tensor:
        """Map (N, 128, H, W) to (N, 9 * factor ** 2, H, W)."""
        return self.up_sample_mask(net)
