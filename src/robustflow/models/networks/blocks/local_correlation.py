"""Correlation of each pixel with a square window around it in a second map (PWC-Net's cost volume, Sun et al. 2018)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

RADIUS = 4
WINDOW = (2 * RADIUS + 1) ** 2
"""Number of channels of a correlation with this radius."""


def local_correlation(features1: Tensor, features2: Tensor, radius: int = RADIUS) -> Tensor:
    """Multiply feature 1 at a pixel by feature 2 at the pixel + (dx, dy), and average over channels; zero outside."""
    height, width = features1.shape[2:]
    features1 = features1.float()
    padded = F.pad(features2.float(), (radius,) * 4)
    side = range(2 * radius + 1)
    shifted = (padded[:, :, y : y + height, x : x + width] for y in side for x in side)
    return torch.stack([(features1 * other).mean(dim=1) for other in shifted], dim=1)
