"""Boundary-dilated warping: the targets of a crop's flow are sampled from the uncropped frame, so that pixels that
leave the crop are not lost (Luo et al., "OccInpFlow", 2020, adopted by UPFlow, CVPR 2021)."""

from __future__ import annotations

import torch
from torch.nn import functional as F
from torch import Tensor

from ...models.networks.blocks.allpairs import pixel_grid


def dilated_warp(whole: Tensor, flow: Tensor, corners: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    """Sample uncropped frames bilinearly at corner + pixel + flow."""
    height, width = whole.shape[2:]
    x, y = _targets(flow, corners).unbind(dim=1)
    inside = inside_frame(flow, corners, sizes)
    grid = torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), dim=-1)
    warped = F.grid_sample(whole.float(), grid, mode="bilinear", padding_mode="border", align_corners=False)
    return warped * inside, inside


def inside_frame(flow: Tensor, corners: Tensor, sizes: Tensor) -> Tensor:
    """Return a mask, float (N, 1, H, W), 1 where the flow of a crop points into the uncropped frame. Arguments as for
    `dilated_warp`."""
    targets, last = _targets(flow, corners), (sizes - 1)[:, :, None, None]
    return ((targets >= 0) & (targets <= last)).all(dim=1, keepdim=True).float()


def _targets(flow: Tensor, corners: Tensor) -> Tensor:
    """Return the coordinates (N, 2, H, W) in the uncropped frame to which the flow of each pixel in a crop points."""
    return (pixel_grid(flow) + corners[:, :, None, None]) + flow.float()
