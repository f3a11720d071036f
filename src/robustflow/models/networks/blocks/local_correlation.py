"""Correlation of each pixel with a square window around it in a second map (PWC-Net's cost volume, Sun et al. 2018)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

RADIUS = 4
WINDOW = (2 * RADIUS + 1) ** 2
"""Number of channels of a correlation with this radius."""


def local_correlation(features1: Tensor, features2: Tensor, radius: int = RADIUS) -> Tensor:
    """Multiply feature 1 at a pixel by feature 2 at the pixel + (dx, dy), and average over channels; zero outside.

    Args:
        features1: features of image 1, (N, C, H, W).
        features2: features of image 2, (N, C, H, W).
        radius: largest |dx| and |dy|, in pixels.

    Returns:
        The correlation, float32 (N, (2 * radius + 1) ** 2, H, W); channel `(dy + radius) * (2 * radius + 1) + dx +
        radius` contains the offset (dx, dy).

    >>> local_correlation(torch.ones(1, 3, 2, 2), torch.ones(1, 3, 2, 2), radius=1)[0, :, 0, 0].tolist()
    [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0]
    """
    height, width = features1.shape[2:]
    features1 = features1.float()
    padded = F.pad(features2.float(), (radius,) * 4)
    side = range(2 * radius + 1)
    shifted = (padded[:, :, y : y + height, x : x + width] for y in side for x in side)
    return torch.stack([(features1 * other).mean(dim=1) for other in shifted], dim=1)
