"""Resize a flow and scale its values accordingly."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def resize(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize maps (N, C, H, W) bilinearly, with aligned corner pixels, to float32 (N, C, *size)."""
    return F.interpolate(maps.float(), size=size, mode="bilinear", align_corners=True)


def resize_flow(flow: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a flow (N, 2, H, W) to (N, 2, *size), and multiply u by the ratio of the widths and v by the ratio of the
    heights.
    """
    ratios = flow.new_tensor([size[1] / flow.shape[3], size[0] / flow.shape[2]], dtype=torch.float32)
    return resize(flow, size) * ratios.view(1, 2, 1, 1)
