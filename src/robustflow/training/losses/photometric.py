"""How unlike two images are, pixel by pixel: structural similarity and the soft census (ternary) distance."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

_LUMA = (0.2989, 0.5870, 0.1140)


def ssim_distance(first: Tensor, second: Tensor) -> Tensor:
    """(1 - SSIM) / 2 over 3x3 windows, clipped to 0..1: (N, C, H - 2, W - 2) from (N, C, H, W) in 0..1.

    >>> image = torch.rand(1, 3, 5, 6)
    >>> ssim_distance(image, image).abs().max().item() < 1e-6
    True
    """
    c1, c2 = 0.01**2, 0.03**2
    mean1, mean2 = _mean(first), _mean(second)
    variance1 = _mean(first * first) - mean1.square()
    variance2 = _mean(second * second) - mean2.square()
    covariance = _mean(first * second) - mean1 * mean2
    similar = (2 * mean1 * mean2 + c1) * (2 * covariance + c2)
    scale = (mean1.square() + mean2.square() + c1) * (variance1 + variance2 + c2)
    return ((1 - similar / scale) / 2).clamp(0, 1)


def census_distance(first: Tensor, second: Tensor, radius: int = 1) -> Tensor:
    """The soft Hamming distance of the images' ternary census transforms (Meister et al., AAAI 2018), the mean over a
    window instead of its sum; 0 within `radius` of the border.

    Args:
        first, second: RGB (N, 3, H, W) in 0..1.
        radius: of the window, pixels.

    Returns:
        (N, 1, H, W), 0 to 1.
    """
    squared = (_census(first, radius) - _census(second, radius)).square()
    distance = (squared / (0.1 + squared)).mean(dim=1, keepdim=True)
    inside = F.pad(torch.ones_like(distance[:, :, radius:-radius, radius:-radius]), [radius] * 4)
    return distance * inside


def _mean(maps: Tensor) -> Tensor:
    return F.avg_pool2d(maps, 3, stride=1)


def _census(image: Tensor, radius: int) -> Tensor:
    """Each pixel's window less the pixel, softly cut to -1..1: (N, (2 radius + 1)^2, H, W)."""
    grey = 255 * (image * image.new_tensor(_LUMA).view(1, 3, 1, 1)).sum(dim=1, keepdim=True)
    side = 2 * radius + 1
    windows = F.unfold(grey, side, padding=radius).unflatten(2, grey.shape[2:])
    difference = windows - grey
    return difference / (0.81 + difference.square()).sqrt()
