"""Which pixels of a frame are seen in the other one, from the flows of both directions (UPFlow's training masks)."""

from __future__ import annotations

import torch
from torch import Tensor

from .blocks.allpairs import pixel_grid
from .blocks.warp import warp


def visible(flow: Tensor, other: Tensor) -> Tensor:
    """Forward and backward flow agree, or the pixel leaves the frame.

    Pixels that leave count as visible: the losses that use these masks sample them from beyond the crop.

    Args:
        flow: (N, 2, H, W), from this frame to the other one, in pixels.
        other: (N, 2, H, W), from the other frame to this one.

    Returns:
        bool (N, 1, H, W).

    >>> flow = torch.full((1, 2, 4, 6), 1.0)
    >>> visible(flow, -flow).all().item(), visible(flow, 9 * flow)[0, 0, 0].tolist()
    (True, [False, False, False, False, False, True])
    """
    difference = (flow + warp(other, flow)).abs().sum(dim=1, keepdim=True)
    bound = 0.1 * (flow.abs().sum(dim=1, keepdim=True) + other.abs().sum(dim=1, keepdim=True)) + 0.5
    height, width = flow.shape[2:]
    x, y = (pixel_grid(flow) + flow).split(1, dim=1)
    leaves = (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)
    return torch.logical_or(difference < bound, leaves)
