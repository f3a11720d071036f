"""SAM's image encoders (Kirillov et al. 2023): ViT-B and ViT-H, and TinyViT-5M (Wu et al. 2022) as in MobileSAM."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...core.errors import ModelError
from .blocks.attention import attend, from_windows, to_windows

_PATCH, _GRID, _WINDOW = 16, 64, 14


@dataclass(frozen=True)
class SamSize:
    """The hyperparameters of a published encoder; blocks in `global_blocks` attend to the complete grid."""

    width: int
    depth: int
    heads: int
    global_blocks: tuple[int, ...]


VIT_B = SamSize(768, 12, 12, (2, 5, 8, 11))
VIT_H = SamSize(1280, 32, 16, (7, 15, 23, 31))


class ChannelNorm(nn.Module):
    """Layer norm over the channels of (N, C, H, W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to (N, C, H, W)."""
        x = F.layer_norm(x.permute(0, 2, 3, 1), self.weight.shape, self.weight, self.bias, eps=1e-6)
        return x.permute(0, 3, 1, 2)


def neck(width: int) -> nn.Sequential:
    """Build the neck that maps the encoder's width to 256 channels; it is the same for the ViTs and TinyViT."""
    return nn.Sequential(
        nn.Conv2d(width, 256, 1, bias=False),
        ChannelNorm(256),
        nn.Conv2d(256, 256, 3, padding=1, bias=False),
        ChannelNorm(256),
    )


def relative_rows(table: Tensor, size: int, first: bool = False) -> Tensor:
    """Select the rows of a relative-position table for all pairs of patches on a line of `size` patches.

    >>> relative_rows(torch.arange(7.0)[:, None], 2)[..., 0].tolist()
    [[3.0, 2.0], [4.0, 3.0]]
    >>> relative_rows(torch.arange(7.0)[:, None], 2, first=True)[..., 0].tolist()
    [[1.0, 0.0], [2.0, 1.0]]
    """
    start = 0 if first else (len(table) - (2 * size - 1)) // 2
    line = torch.arange(size, device=table.device)
    return table[line[:, None] - line[None, :] + size - 1 + start]


class Attention(nn.Module):
    """Self-attention on a grid with decomposed relative positions."""

    def __init__(self, width: int, heads: int, grid: int, first_rows: bool) -> None:
        super().__init__()
        self.heads = heads
        self.first_rows = first_rows
        self.rel_pos_h = nn.Parameter(torch.zeros(2 * grid - 1, width // heads))
        self.rel_pos_w = nn.Parameter(torch.zeros(2 * grid - 1, width // heads))
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, tokens: Tensor, height: int, width: int) -> Tensor:
        """Map tokens (M, height * width, C) to the same shape."""
        query, key, value = self.qkv(tokens).chunk(3, dim=-1)
        # The position terms use the unscaled query.
        grid = query.unflatten(-1, (self.heads, -1)).unflatten(1, (height, width))
        rows = relative_rows(self.rel_pos_h, height, self.first_rows)
        columns = relative_rows(self.rel_pos_w, width, self.first_rows)
        bias_h = torch.einsum("myxhc,ykc->mhyxk", grid, rows)
        bias_w = torch.einsum("myxhc,xkc->mhyxk", grid, columns)
        bias = (bias_h[..., :, None] + bias_w[..., None, :]).flatten(4).flatten(2, 3)
        return self.proj(attend(query, key, value, self.heads, bias))


class Block(nn.Module):
    """A transformer block: pre-norm attention, in windows of 14 x 14 or over the complete grid, and an MLP."""

    def __init__(self, width: int, heads: int, windowed: bool, first_rows: bool) -> None:
        super().__init__()
        self.windowed = windowed
        self.norm1 = nn.LayerNorm(width, eps=1e-6)
        self.attn = Attention(width, heads, _WINDOW if windowed else _GRID, first_rows)
        self.norm2 = nn.LayerNorm(width, eps=1e-6)
        layers = {"lin1": nn.Linear(width, 4 * width), "gelu": nn.GELU(), "lin2": nn.Linear(4 * width, width)}
        self.mlp = nn.Sequential(OrderedDict(layers))

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C)."""
        height, width = x.shape[1:3]
        y = self.norm1(x)
        if self.windowed:
            windows = to_windows(y, _WINDOW)
            y = self.attn(windows.flatten(0, 1), _WINDOW, _WINDOW).view(windows.shape)
            y = from_windows(y, height, width)
        else:
            y = self.attn(y.flatten(1, 2), height, width).view(x.shape)
        x = x + y
        return x + self.mlp(self.norm2(x))


class SamVit(nn.Module):
    """The encoder from an image to 256 channels at 1/16 resolution."""

    def __init__(self, size: SamSize, first_rows: bool = False) -> None:
        super().__init__()
        self.pos_embed = nn.Parameter(torch.zeros(1, _GRID, _GRID, size.width))
        self.patch_embed = nn.ModuleDict({"proj": nn.Conv2d(3, size.width, _PATCH, stride=_PATCH)})
        self.blocks = nn.ModuleList(
            Block(size.width, size.heads, index not in size.global_blocks, first_rows) for index in range(size.depth)
        )
        self.neck = neck(size.width)

    def forward(self, image: Tensor) -> Tensor:
        """Map normalised images (N, 3, 16 * H, 16 * W) to (N, 256, H, W)."""
        x = self.patch_embed["proj"](image).permute(0, 2, 3, 1)
        height, width = x.shape[1:3]
        if max(height, width) > _GRID:
            most = f"{_PATCH * _GRID}x{_PATCH * _GRID}"
            message = f"the SAM encoder has positions for frames of up to {most}; predict in tiles (option tile)"
            raise ModelError(f"{_PATCH * height}x{_PATCH * width}", message)
        x = x + self.pos_embed[:, :height, :width]
        for block in self.blocks:
            x = block(x)
        return self.neck(x.permute(0, 3, 1, 2))


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


class TinyVitBlock(nn.Module):
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
    """Blocks, then a layer that widens the map for the next stage, with a stride except before the last."""

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
            blocks: list[nn.Module] = [TinyVitBlock(width, heads, window) for _ in range(depth)]
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
