"""Boundary-dilated warping: what a crop's flow points at is sampled from the whole frame, so that a pixel that leaves
the crop is not lost (Luo et al., "OccInpFlow", 2020, taken up by UPFlow, CVPR 2021)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...models.networks.blocks.allpairs import pixel_grid


def dilated_warp(whole: Tensor, flow: Tensor, corners: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    """Sample whole frames bilinearly at corner + pixel + flow.

    Args:
        whole: (N, C, H', W'); values beyond a frame's size mean nothing.
        flow: (N, 2, H, W) of the crops, pixels.
        corners: (N, 2), x and y of each crop's first pixel in its frame.
        sizes: (N, 2), width and height of each frame.

    Returns:
        (N, C, H, W), 0 outside the frame, and float (N, 1, H, W), 1 inside it.

    >>> whole = torch.arange(6.0).view(1, 1, 1, 6).repeat(1, 1, 2, 1)
    >>> flow = torch.tensor([2.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 3)
    >>> warped, inside = dilated_warp(whole, flow, torch.tensor([[2.0, 0.0]]), torch.tensor([[6.0, 2.0]]))
    >>> warped.flatten().tolist(), inside.flatten().tolist()
    ([4.0, 5.0, 0.0], [1.0, 1.0, 0.0])
    """
    height, width = whole.shape[2:]
    x, y = _targets(flow, corners).unbind(dim=1)
    inside = inside_frame(flow, corners, sizes)
    grid = torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), dim=-1)
    warped = F.grid_sample(whole.float(), grid, mode="bilinear", padding_mode="border", align_corners=False)
    return warped * inside, inside


def inside_frame(flow: Tensor, corners: Tensor, sizes: Tensor) -> Tensor:
    """float (N, 1, H, W): 1 where the flow of a crop points into the whole frame. Arguments as for `dilated_warp`."""
    targets, last = _targets(flow, corners), (sizes - 1)[:, :, None, None]
    return ((targets >= 0) & (targets <= last)).all(dim=1, keepdim=True).float()


def _targets(flow: Tensor, corners: Tensor) -> Tensor:
    """The pixel of the whole frame that the flow of each pixel of a crop points at, (N, 2, H, W).

    Rounded only once, because pixel and corner are whole numbers: the gradient jumps at the pixels of the frame.
    """
    return (pixel_grid(flow) + corners[:, :, None, None]) + flow.float()


def leaves(flow: Tensor) -> Tensor:
    """float (N, 1, H, W): 1 where a flow (N, 2, H, W) points outside the crop."""
    height, width = flow.shape[2:]
    x, y = (pixel_grid(flow) + flow).split(1, dim=1)
    return ((x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)).float()
