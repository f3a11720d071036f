"""The first two stages of Twins-SVT (Chu et al. 2021), the image encoder of FlowFormer and its descendants."""

from __future__ import annotations

from collections import OrderedDict

import torch.nn.functional as F
from torch import Tensor, nn

from .attention import attend, from_windows, to_windows

# Width of the last of the four stages; the checkpoints contain only the norm of this stage, which is not used.
_LARGE = ((128, 256), (4, 8), 1024)
_SMALL = ((64, 128), (2, 4), 512)


def mlp(width: int) -> nn.Sequential:
    """Build an MLP that maps (..., width) to the same shape: linear to four times the width, exact GELU, linear."""
    layers = {"fc1": nn.Linear(width, 4 * width), "gelu": nn.GELU(), "fc2": nn.Linear(4 * width, width)}
    return nn.Sequential(OrderedDict(layers))


class WindowAttention(nn.Module):
    """Self-attention in windows of 7 x 7."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C)."""
        query, key, value = self.qkv(to_windows(x, 7)).chunk(3, dim=-1)
        return self.proj(from_windows(attend(query, key, value, self.heads), *x.shape[1:3]))


class ReducedAttention(nn.Module):
    """Attention from every pixel to the complete map, which is downsampled by a strided convolution."""

    def __init__(self, width: int, heads: int, reduction: int) -> None:
        super().__init__()
        self.heads = heads
        self.q = nn.Linear(width, width)
        self.kv = nn.Linear(width, 2 * width)
        self.proj = nn.Linear(width, width)
        self.sr = nn.Conv2d(width, width, reduction, stride=reduction)
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C)."""
        shrunk = self.sr(x.permute(0, 3, 1, 2)).flatten(2).transpose(1, 2)
        key, value = self.kv(self.norm(shrunk)).chunk(2, dim=-1)
        return self.proj(attend(self.q(x.flatten(1, 2)), key, value, self.heads)).reshape(x.shape)


class Block(nn.Module):
    """A transformer block: pre-norm attention and MLP, each with a residual."""

    def __init__(self, width: int, attention: nn.Module) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=1e-6)
        self.attn = attention
        self.norm2 = nn.LayerNorm(width, eps=1e-6)
        self.mlp = mlp(width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C)."""
        x = x + self.attn(self.norm1(x))
        return x + self.mlp(self.norm2(x))


class PatchEmbedding(nn.Module):
    """Patch embedding: a strided convolution and a norm."""

    def __init__(self, inputs: int, width: int, patch: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(inputs, width, patch, stride=patch)
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, dense: bool = False) -> Tensor:
        """Map (N, C, H, W) to (N, H / patch, W / patch, width), or to (N, H, W, width) if `dense`: there is then one
        patch per pixel, with this pixel as its lower right corner, and zeros above and to the left of the map.
        """
        if dense:
            before = self.proj.kernel_size[0] - 1
            x = F.conv2d(F.pad(x, (before, 0, before, 0)), self.proj.weight, self.proj.bias)
        else:
            x = self.proj(x)
        return self.norm(x.permute(0, 2, 3, 1))


class PositionConv(nn.Module):
    """Positional encoding by a depthwise 3 x 3 convolution with a residual."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.proj = nn.Sequential(nn.Conv2d(width, width, 3, padding=1, groups=width))

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, H, W, C) to (N, H, W, C)."""
        return x + self.proj(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)


class _Stages(nn.Module):
    def __init__(self, widths: tuple[int, int], heads: tuple[int, int], last: int) -> None:
        super().__init__()
        self.patch_embeds = nn.ModuleList(
            PatchEmbedding(*shape) for shape in ((3, widths[0], 4), (widths[0], widths[1], 2))
        )
        self.blocks = nn.ModuleList(
            nn.ModuleList(
                (Block(width, WindowAttention(width, n)), Block(width, ReducedAttention(width, n, reduction)))
            )
            for width, n, reduction in zip(widths, heads, (8, 4), strict=True)
        )
        self.pos_block = nn.ModuleList(PositionConv(width) for width in widths)
        self.norm = nn.LayerNorm(last, eps=1e-6)


class Twins(nn.Module):
    """The first two stages of Twins-SVT (1/4 and 1/8 resolution), under the state-dict key `svt`."""

    def __init__(self, large: bool = True) -> None:
        super().__init__()
        self.svt = _Stages(*(_LARGE if large else _SMALL))

    def stage(self, index: int, x: Tensor, dense: bool = False) -> Tensor:
        """Apply one stage: map (N, C, H, W) to (N, width, H / patch, W / patch); `dense` as in `PatchEmbedding`."""
        x = self.svt.patch_embeds[index](x, dense)
        local, reduced = self.svt.blocks[index]
        x = reduced(self.svt.pos_block[index](local(x)))
        return x.permute(0, 3, 1, 2).contiguous()

    def forward(self, image: Tensor) -> Tensor:
        """Map images (N, 3, H, W) in -1..1, H and W multiples of 8, to (N, width, H / 8, W / 8)."""
        return self.stage(1, self.stage(0, image))
