"""Attention between the pixels of image 1, separately for each latent cost token (FlowFormer, Huang et al. 2022, 3.2).

Queries and keys also include the context features, so that motion propagates within objects rather than across them.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend, from_windows, linear_sine, to_windows
from .blocks.correlation import pixel_grid
from .blocks.twins import mlp

_WIDTH, _CONTEXT, _PROJECTED, _HEADS = 128, 256, 64, 8


def _position_code(height: int, width: int, step: int, channels: int, like: Tensor) -> Tensor:
    """Return the positional encoding of every `step`-th pixel in a map, (height * width, channels)."""
    grid = pixel_grid(like.new_empty(1, 1, height, width)).flatten(2)[0].T
    return linear_sine(step * grid, channels).to(like.dtype)


class _ContextAttention(nn.Module):
    """Base class of the two attention blocks, which appends the projected context to the tokens."""

    def __init__(self) -> None:
        super().__init__()
        self.context_proj = nn.Linear(_CONTEXT, _PROJECTED)

    def beside_context(self, x: Tensor, context: Tensor) -> Tensor:
        """Append the context (N, H, W, 256) to the tokens (N * K, H, W, C); the result is (N * K, H, W, C + 64)."""
        projected = self.context_proj(context).repeat_interleave(len(x) // len(context), dim=0)
        return torch.cat((x, projected), dim=-1)


class LocalContextAttention(_ContextAttention):
    """Attention within windows of 7 x 7."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.k = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Map (N * K, H, W, C) and (N, H, W, 256) to (N * K, H, W, C)."""
        windows = to_windows(self.beside_context(x, context), 7)
        windows = windows + _position_code(7, 7, 1, windows.shape[-1], windows)
        mixed = attend(self.q(windows), self.k(windows), self.v(to_windows(x, 7)), _HEADS)
        return self.proj(from_windows(mixed, *x.shape[1:3]))


class ReducedContextAttention(_ContextAttention):
    """Attention to the complete map, which is downsampled by a factor of four."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.k = nn.Linear(_WIDTH, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)
        self.sr_key = nn.Conv2d(_WIDTH + _PROJECTED, _WIDTH, 4, stride=4)
        self.sr_value = nn.Conv2d(_WIDTH, _WIDTH, 4, stride=4)
        self.norm = nn.LayerNorm(_WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Map (N * K, H, W, C) and (N, H, W, 256) to (N * K, H, W, C)."""
        height, width = x.shape[1:3]
        seen = self.beside_context(x, context)
        query = self.q(seen.flatten(1, 2) + _position_code(height, width, 1, seen.shape[-1], seen))
        key, value = self._shrink(self.sr_key, seen), self._shrink(self.sr_value, x)
        key = self.k(key + _position_code(-(-height // 4), -(-width // 4), 4, _WIDTH, key))
        return self.proj(attend(query, key, self.v(value), _HEADS)).reshape(x.shape)

    def _shrink(self, convolution: nn.Conv2d, x: Tensor) -> Tensor:
        """Map (M, H, W, C), zero-padded at the bottom and on the right, to (M, ceil(H / 4) * ceil(W / 4), 128)."""
        x = F.pad(x.permute(0, 3, 1, 2), (0, -x.shape[2] % 4, 0, -x.shape[1] % 4))
        return self.norm(convolution(x).flatten(2).transpose(1, 2))


class _ContextBlock(nn.Module):
    def __init__(self, attention: nn.Module) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(_WIDTH)
        self.attn = attention
        self.norm2 = nn.LayerNorm(_WIDTH)
        self.mlp = mlp(_WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        x = x + self.attn(self.norm1(x), context)
        return x + self.mlp(self.norm2(x))


class VerticalAttention(nn.Module):
    """A layer of local attention followed by downsampled global attention."""

    def __init__(self) -> None:
        super().__init__()
        self.local_block = _ContextBlock(LocalContextAttention())
        self.global_block = _ContextBlock(ReducedContextAttention())

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Update tokens (N * K, H, W, 128), where the K tokens of a pixel form K maps, given the context (N, H, W,
        256).
        """
        return self.global_block(self.local_block(x, context), context)
