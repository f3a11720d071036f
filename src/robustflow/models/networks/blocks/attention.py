"""Attention on windows and on lists of tokens, without the projections, and global motion aggregation (GMA, Jiang et
al. 2021)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def to_windows(x: Tensor, size: int) -> Tensor:
    """Split a map into windows, row by row, zero-padded at the bottom and on the right."""
    n, height, width, channels = x.shape
    x = F.pad(x, (0, 0, 0, -width % size, 0, -height % size))
    rows, columns = x.shape[1] // size, x.shape[2] // size
    x = x.reshape(n, rows, size, columns, size, channels).transpose(2, 3)
    return x.reshape(n, rows * columns, size * size, channels)


def from_windows(windows: Tensor, height: int, width: int) -> Tensor:
    """Merge `windows` from `to_windows` into the map (N, height, width, C), and remove the padding."""
    n, _, area, channels = windows.shape
    size = round(area**0.5)
    rows, columns = -(-height // size), -(-width // size)
    x = windows.reshape(n, rows, columns, size, size, channels).transpose(2, 3)
    return x.reshape(n, rows * size, columns * size, channels)[:, :height, :width]


def attend(query: Tensor, key: Tensor, value: Tensor, heads: int = 1, bias: Tensor | None = None) -> Tensor:
    """Apply softmax attention with scale 1 / sqrt(head width); the heads are consecutive groups of channels."""
    query, key, value = (t.unflatten(-1, (heads, -1)).transpose(-2, -3) for t in (query, key, value))
    return F.scaled_dot_product_attention(query, key, value, attn_mask=bias).transpose(-2, -3).flatten(-2)


def linear_sine(coordinates: Tensor, channels: int) -> Tensor:
    """Compute FlowFormer's positional encoding: sine and cosine at linearly spaced frequencies (Huang et al. 2022)."""
    bands = torch.arange(channels // 4, dtype=coordinates.dtype, device=coordinates.device)
    angle_x, angle_y = (3.14 * coordinates[..., axis, None] * bands / 200 for axis in (0, 1))
    return torch.cat((angle_x.sin(), angle_x.cos(), angle_y.sin(), angle_y.cos()), dim=-1)


def context_attention(query_key: Tensor) -> Tensor:
    """Compute single-head attention between all pairs of pixels from a map of queries and keys."""
    query, key = query_key.flatten(2).chunk(2, dim=1)
    return (query.transpose(1, 2) * query.shape[1] ** -0.5 @ key).softmax(dim=-1)


def gather(attention: Tensor, values: Tensor) -> Tensor:
    """Return the attention-weighted mean of `values` (N, C, H, W) for every pixel, in the same shape."""
    return (values.flatten(2) @ attention.transpose(1, 2)).reshape(values.shape)
