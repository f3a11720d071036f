"""Detect pixels of a frame that are not visible in the other frame, from the flows in both directions."""

from __future__ import annotations

import torch
from torch import Tensor

from ...models.networks.blocks.allpairs import pixel_grid
from ...models.networks.blocks.warp import warp


def seen_by_check(forward: Tensor, backward: Tensor) -> Tensor:
    """Return 1 where the flows in both directions, float (N, 2, H, W), in pixels, are consistent: |f + b|^2 <= 0.01
    (|f|^2 + |b|^2) + 0.5 (Sundaram et al., ECCV 2010); otherwise 0, float (N, 1, H, W)."""
    returned = warp(backward, forward)
    off = (forward + returned).square().sum(dim=1, keepdim=True)
    length = forward.square().sum(dim=1, keepdim=True) + returned.square().sum(dim=1, keepdim=True)
    return (off <= 0.01 * length + 0.5).to(forward.dtype)


def seen_by_splat(backward: Tensor) -> Tensor:
    """Return 1 where the pixels of the other frame, moved by the backward flow, cover at least a fifth of a pixel (Wang
    et al., CVPR 2018); shape and values as in `seen_by_check`."""
    return (coverage(backward) >= 0.2).to(backward.dtype)


def coverage(flow: Tensor, values: Tensor | None = None) -> Tensor:
    """Move every pixel by its flow, splat its value bilinearly, and return the sum at each pixel, (N, 1, H, W)."""
    count, _, height, width = flow.shape
    x, y = (pixel_grid(flow) + flow).flatten(2).unbind(dim=1)
    left, top = x.floor(), y.floor()
    carried = torch.ones_like(x) if values is None else values.flatten(1)
    landed = flow.new_zeros(count, height * width)
    for column in (left, left + 1):
        for row in (top, top + 1):
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            share = torch.where(inside, (1 - (x - column).abs()) * (1 - (y - row).abs()), 0.0) * carried
            place = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
            landed = landed.scatter_add(1, place.long(), share)
    return landed.view(count, 1, height, width)
