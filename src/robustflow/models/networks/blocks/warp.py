"""Backward warping: sample a map along a flow, as in coarse-to-fine networks between levels."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .allpairs import pixel_grid


def warp(maps: Tensor, flow: Tensor, padding: str = "zeros", align_corners: bool = True) -> Tensor:
    """Sample `maps` bilinearly at pixel + flow."""
    height, width = maps.shape[2:]
    with torch.autocast(maps.device.type, enabled=False):
        x, y = (pixel_grid(maps) + flow.float()).unbind(dim=1)
        grid = torch.stack((2 * x / max(width - 1, 1) - 1, 2 * y / max(height - 1, 1) - 1), dim=-1)
        return F.grid_sample(maps.float(), grid, mode="bilinear", padding_mode=padding, align_corners=align_corners)


def inside_mask(flow: Tensor, threshold: float, align_corners: bool = True) -> Tensor:
    """Return a mask of the flow targets inside the map: 1 where the bilinear weights inside the map sum to at least
    `threshold`, otherwise 0.
    """
    ones = torch.ones_like(flow[:, :1], dtype=torch.float32)
    return (warp(ones, flow, align_corners=align_corners) >= threshold).float()


def leaves(flow: Tensor) -> Tensor:
    """Return a mask of the pixels whose flow (N, 2, H, W), in pixels, points outside the map, bool (N, 1, H, W)."""
    height, width = flow.shape[2:]
    x, y = (pixel_grid(flow) + flow).split(1, dim=1)
    return (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)
