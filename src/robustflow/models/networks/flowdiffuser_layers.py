"""FlowDiffuser's layers: the transformer of both images' features, and the decoder of SKFlow's large-kernel blocks."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend, context_attention, from_windows, gather, to_windows
from .blocks.raft import mask_layers

_WIDTH, _WINDOW = 256, 8


def mask_bias(labels: Tensor) -> Tensor:
    """Return a bias of -100 for the logits of token pairs with different labels: (..., N, N) for labels (..., N)."""
    return (labels[..., :, None] != labels[..., None, :]).to(torch.float32) * -100


class Attention(nn.Module):
    """Single-head attention."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH, _WIDTH)
        self.k = nn.Linear(_WIDTH, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)

    def forward(self, x: Tensor, other: Tensor, bias: Tensor) -> Tensor:
        """Map tokens (..., N, 256), which attend to (..., M, 256), to the same shape."""
        return self.proj(attend(self.q(x), self.k(other), self.v(other), bias=bias.to(x.dtype)))


def _mlp() -> nn.Sequential:
    return nn.Sequential(nn.Linear(_WIDTH, 4 * _WIDTH), nn.GELU(), nn.Linear(4 * _WIDTH, _WIDTH))


class WindowBlock(nn.Module):
    """Self-attention in windows of 8 x 8."""

    def __init__(self, shift: int) -> None:
        super().__init__()
        self.shift = shift
        self.layer_norm1 = nn.LayerNorm(_WIDTH)
        self.layer_norm2 = nn.LayerNorm(_WIDTH)
        self.self_attn = Attention()
        self.mlp = _mlp()

    def forward(self, x: Tensor, labels: Tensor) -> Tensor:
        """Update a map (N, H, W, 256), H and W multiples of 8; pixels with different `labels` (H, W) do not attend to
        each other.
        """
        height, width = labels.shape
        if self.shift:
            # The shift also puts pixels from opposite edges into one window; these must not attend to each other.
            y, x_ = (torch.arange(size, device=x.device) for size in (height, width))
            wrapped = 2 * (y < self.shift).long()[:, None] + (x_ < self.shift).long()
            labels = 4 * labels + wrapped
        roll = (-self.shift, -self.shift)
        windows = to_windows(self.layer_norm1(x).roll(roll, (1, 2)), _WINDOW)
        bias = mask_bias(to_windows(labels.roll(roll, (0, 1))[None, ..., None], _WINDOW)[..., 0])[:, :, None]
        mixed = from_windows(self.self_attn(windows, windows, bias), height, width)
        x = x + mixed.roll((self.shift, self.shift), (1, 2))
        return x + self.mlp(self.layer_norm2(x))


class CrossBlock(nn.Module):
    """Global cross-attention from one image to the other."""

    def __init__(self) -> None:
        super().__init__()
        self.layer_norm1 = nn.LayerNorm(_WIDTH)
        self.layer_norm2 = nn.LayerNorm(_WIDTH)
        self.layer_norm3 = nn.LayerNorm(_WIDTH)
        self.cross_attn = Attention()
        self.mlp = _mlp()

    def forward(self, x: Tensor, other: Tensor, bias: Tensor) -> Tensor:
        """Update tokens (N, H * W, 256) by attention to those of the second image, with `bias` (H * W, H * W) added to
        the logits.
        """
        x = x + self.cross_attn(self.layer_norm1(x), self.layer_norm2(other), bias)
        return x + self.mlp(self.layer_norm3(x))


class Layer(nn.Module):
    """A layer of two window blocks and, in the first layer only, a cross-attention block."""

    def __init__(self, cross: bool) -> None:
        super().__init__()
        self.blocks = nn.ModuleList((WindowBlock(0), WindowBlock(_WINDOW // 2)))
        if cross:
            self.cross_transformer = CrossBlock()

    def forward(self, x: Tensor, labels: Tensor) -> Tensor:
        """Update the features of images 1 and 2, stacked along the batch axis, (2 * N, H, W, 256)."""
        for block in self.blocks:
            x = block(x, labels)
        if not hasattr(self, "cross_transformer"):
            return x
        first, second = x.flatten(1, 2).chunk(2)
        bias = mask_bias(labels.flatten())
        # The block already contains residuals; the published model adds another one around the block.
        second = second + self.cross_transformer(second, first, bias)
        first = first + self.cross_transformer(first, second, bias)
        return torch.cat((first, second)).view(x.shape)


class PairTransformer(nn.Module):
    """The transformer that enhances the features of both images by attention between the images."""

    def __init__(self) -> None:
        super().__init__()
        self.tb = nn.ModuleDict({"blocks": nn.ModuleList((Layer(cross=True), Layer(cross=False)))})

    def forward(self, features1: Tensor, features2: Tensor) -> tuple[Tensor, Tensor]:
        """Update features (N, 256, H, W) of any size; they are padded at the top and on both sides to a multiple of the
        window size, and masked.
        """
        _, _, height, width = features1.shape
        over_x, over_y = -width % _WINDOW, -height % _WINDOW
        left = over_x // 2
        x = torch.cat((features1, features2)).permute(0, 2, 3, 1)
        x = F.pad(x, (0, 0, left, over_x - left, over_y, 0))
        labels = torch.ones(x.shape[1:3], dtype=torch.long, device=x.device)
        labels[over_y:, left : left + width] = 0
        for layer in self.tb["blocks"]:
            x = layer(x, labels)
        x = x[:, over_y:, left : left + width].permute(0, 3, 1, 2)
        return x.chunk(2)


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
