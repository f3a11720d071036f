"""Detect pixels of a frame that are not visible in the other frame, from the flows in both directions."""

from __future__ import annotations

import torch
from torch import Tensor

from ...models.networks.blocks.allpairs import pixel_grid
from ...models.networks.blocks.warp import warp


def seen_by_check(forward: Tensor, backward: Tensor, scale: float = 0.01, bias: float = 0.5) -> Tensor:
    """Return 1 where the forward and backward flow are consistent: |f + b|^2 <= scale (|f|^2 + |b|^2) + bias.

    Args:
        forward, backward: flow in both directions, float (N, 2, H, W), in pixels.
        scale, bias: parameters of the tolerance (Sundaram et al., ECCV 2010).

    Returns:
        A mask, float (N, 1, H, W), 0 where the pixel is occluded.
    """
    returned = warp(backward, forward)
    off = (forward + returned).square().sum(dim=1, keepdim=True)
    length = forward.square().sum(dim=1, keepdim=True) + returned.square().sum(dim=1, keepdim=True)
    return (off <= scale * length + bias).to(forward.dtype)


def seen_by_splat(backward: Tensor, threshold: float = 0.2) -> Tensor:
    """Return 1 where the pixels of the other frame, moved by the backward flow, cover at least a fraction `threshold`
    of a pixel (Wang et al., CVPR 2018); shape and values as in `seen_by_check`."""
    return (coverage(backward).clamp(0, 1) >= threshold).to(backward.dtype)


def coverage(flow: Tensor, values: Tensor | None = None) -> Tensor:
    """Move every pixel by its flow, splat its value bilinearly, and return the sum at each pixel, (N, 1, H, W).

    Contributions outside the frame are lost.

    Args:
        flow: flow, float (N, 2, H, W), in pixels.
        values: value of each pixel, float (N, 1, H, W); 1 by default.

    >>> coverage(torch.zeros(1, 2, 2, 3)).flatten().tolist()
    [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    """
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
