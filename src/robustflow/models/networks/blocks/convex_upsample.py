"""Convex upsampling: each fine pixel is a weighted mean of 3 x 3 coarse pixels (RAFT, Teed and Deng 2020, section
3.3).
"""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn


def mask_layers(factor: int = 8) -> nn.Sequential:
    """Build the head that maps a state (N, 128, H, W) to the logits of `convex_upsample`, (N, 9 * factor ** 2, H,
    W).
    """
    return nn.Sequential(nn.Conv2d(128, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 9 * factor * factor, 1))


def convex_upsample(flow: Tensor, mask: Tensor, factor: int = 8) -> Tensor:
    """Upsample a flow with a predicted mask."""
    n, channels, height, width = flow.shape
    weights = mask.float().view(n, 1, 9, factor, factor, height, width).softmax(dim=2)
    neighbours = F.unfold(factor * flow.float(), kernel_size=3, padding=1)
    neighbours = neighbours.view(n, channels, 9, 1, 1, height, width)
    fine = (weights * neighbours).sum(dim=2).permute(0, 1, 4, 2, 5, 3)
    return fine.reshape(n, channels, factor * height, factor * width)
