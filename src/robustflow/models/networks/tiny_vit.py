"""TinyViT-5M (Wu et al. 2022) in the version of MobileSAM (Zhang et al. 2023): the last stage keeps 1/16 resolution."""

from __future__ import annotations

from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend, from_windows, to_windows
from .sam_vit import neck

# Width, depth, heads and window of the three attention stages.
_STAGES = ((128, 2, 4, 7), (160, 6, 5, 14), (320, 2, 10, 7))


def conv_norm(inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """A convolution without bias, followed by batch norm."""
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False)
    return nn.Sequential(OrderedDict(c=convolution, bn=nn.BatchNorm2d(outputs)))


class _Bottleneck(nn.Module):
    """Three convolutions: 1 x 1, depthwise 3 x 3, 1 x 1."""

    def __init__(self, inputs: int, hidden: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = conv_norm(inputs, hidden)
        self.conv2 = conv_norm(hidden, hidden, 3, stride, groups=hidden)
        self.conv3 = conv_norm(hidden, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv3(F.gelu(self.conv2(F.gelu(self.conv1(x)))))


class InvertedBottleneck(_Bottleneck):
    """An inverted residual block whose inner width is four times the outer width; a GELU follows the residual."""

    def __init__(self, width: int) -> None:
        super().__init__(width, 4 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to (N, C, H, W)."""
        return F.gelu(x + super().forward(x))


def distance_index(size: int) -> Tensor:
    """Return the index of the learned bias for each pair of pixels in a window; there is one bias per (|dy|, |dx|)."""
    pixel = torch.arange(size * size)
    y, x = pixel // size, pixel % size
    return (y[:, None] - y).abs() * size + (x[:, None] - x).abs()


class WindowAttention(nn.Module):
    """Pre-norm self-attention in windows."""

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads = heads
        self.window = window
        self.attention_biases = nn.Parameter(torch.zeros(heads, window * window))
        self.register_buffer("index", distance_index(window), persistent=False)
        self.norm = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C). Padding pixels of the last windows are not masked."""
        qkv = self.qkv(self.norm(to_windows(x, self.window)))
        # The channels of each head's query, key and value are adjacent.
        query, key, value = (t.flatten(-2) for t in qkv.unflatten(-1, (self.heads, -1)).chunk(3, dim=-1))
        mixed = attend(query, key, value, self.heads, self.attention_biases[:, self.index])
        return self.proj(from_windows(mixed, *x.shape[1:3]))


class Block(nn.Module):
    """A transformer block: window attention, a depthwise convolution and an MLP."""

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__()
        self.attn = WindowAttention(width, heads, window)
        layers = {"fc1": nn.Linear(width, 4 * width), "gelu": nn.GELU(), "fc2": nn.Linear(4 * width, width)}
        self.mlp = nn.Sequential(OrderedDict({"norm": nn.LayerNorm(width), **layers}))
        self.local_conv = conv_norm(width, width, 3, groups=width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to (N, C, H, W)."""
        x = x + self.attn(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        x = self.local_conv(x)
        return x + self.mlp(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class Stage(nn.Module):
    """A stage: blocks, followed by a layer that widens the map for the next stage, and downsamples it except before the
    last stage.
    """

    def __init__(self, blocks: list[nn.Module], width: int, following: int | None, stride: int = 2) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)
        if following is not None:
            self.downsample = _Bottleneck(width, following, following, stride)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, width, H, W) to (N, following, H / stride, W / stride), or, in the last stage, to the same shape."""
        for block in self.blocks:
            x = block(x)
        return self.downsample(x) if hasattr(self, "downsample") else x


class TinyVit(nn.Module):
    """The encoder from an image to 256 channels at 1/16 resolution."""

    def __init__(self) -> None:
        super().__init__()
        stem = nn.Sequential(conv_norm(3, 32, 3, stride=2), nn.GELU(), conv_norm(32, 64, 3, stride=2))
        self.patch_embed = nn.ModuleDict({"seq": stem})
        self.layers = nn.ModuleList([Stage([InvertedBottleneck(64) for _ in range(2)], 64, _STAGES[0][0])])
        for index, (width, depth, heads, window) in enumerate(_STAGES):
            following = _STAGES[index + 1][0] if index + 1 < len(_STAGES) else None
            blocks: list[nn.Module] = [Block(width, heads, window) for _ in range(depth)]
            self.layers.append(Stage(blocks, width, following, stride=2 if index == 0 else 1))
        self.norm_head = nn.LayerNorm(320)
        self.head = nn.Linear(320, 1000)
        self.neck = neck(320)

    def forward(self, image: Tensor) -> Tensor:
        """Map normalised images (N, 3, 16 * H, 16 * W) to (N, 256, H, W)."""
        x = self.patch_embed["seq"](image)
        for layer in self.layers:
            x = layer(x)
        return self.neck(x)
