"""Multi-head attention on token lists, excluding the projections, whose names differ between networks."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def attend(query: Tensor, key: Tensor, value: Tensor, heads: int = 1, bias: Tensor | None = None) -> Tensor:
    """Apply softmax attention with scale 1 / sqrt(head width); the heads are consecutive groups of channels."""
    query, key, value = (t.unflatten(-1, (heads, -1)).transpose(-2, -3) for t in (query, key, value))
    return F.scaled_dot_product_attention(query, key, value, attn_mask=bias).transpose(-2, -3).flatten(-2)


def linear_sine(coordinates: Tensor, channels: int) -> Tensor:
    """Compute FlowFormer's positional encoding: sine and cosine at linearly spaced frequencies (Huang et al. 2022)."""
    bands = torch.arange(channels // 4, dtype=coordinates.dtype, device=coordinates.device)
    angle_x, angle_y = (3.14 * coordinates[..., axis, None] * bands / 200 for axis in (0, 1))
    return torch.cat((angle_x.sin(), angle_x.cos(), angle_y.sin(), angle_y.cos()), dim=-1)
