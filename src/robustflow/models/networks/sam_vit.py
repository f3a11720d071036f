"""The image encoder of Segment Anything (Kirillov et al. 2023): a ViT with windows and decomposed relative positions.

The published position tables were trained for a grid of 64 x 64 patches. SAMFlow crops them for smaller grids; larger
grids are not supported.
"""

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
            raise ModelError(
                f"the SAM encoder has position tables for {_PATCH * _GRID}x{_PATCH * _GRID} pixels, not for "
                f"{_PATCH * height}x{_PATCH * width}; predict in tiles (option tile)"
            )
        x = x + self.pos_embed[:, :height, :width]
        for block in self.blocks:
            x = block(x)
        return self.neck(x.permute(0, 3, 1, 2))
