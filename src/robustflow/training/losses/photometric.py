"""Measure the difference between two images at each pixel: structural similarity and the soft census (ternary)
distance."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

Luma = tuple[float, float, float]

LUMA: Luma = (0.2989, 0.5870, 0.1140)
"""Weights of red, green and blue in the grey value."""


def ssim_distance(first: Tensor, second: Tensor) -> Tensor:
    """Compute (1 - SSIM) / 2 over 3x3 windows, clipped to 0..1: (N, C, H - 2, W - 2) from images (N, C, H, W) in
    0..1.
    """
    c1, c2 = 0.01**2, 0.03**2
    mean1, mean2 = _mean(first), _mean(second)
    variance1 = _mean(first * first) - mean1.square()
    variance2 = _mean(second * second) - mean2.square()
    covariance = _mean(first * second) - mean1 * mean2
    similar = (2 * mean1 * mean2 + c1) * (2 * covariance + c2)
    scale = (mean1.square() + mean2.square() + c1) * (variance1 + variance2 + c2)
    return ((1 - similar / scale) / 2).clamp(0, 1)


def census_distance(first: Tensor, second: Tensor) -> Tensor:
    """Return the soft Hamming distance of the images' ternary census transforms (Meister et al., AAAI 2018), averaged
    over 3x3 windows instead of summed: (N, 1, H, W), 0..1; 0 at the border. Images are RGB, float (N, 3, H, W), 0..1.
    """
    distance = _differing(first, second, 1, LUMA, 255.0).mean(dim=1, keepdim=True)
    return distance * inner(distance, 1)


def census_sum(first: Tensor, second: Tensor, radius: int = 3, luma: Luma = LUMA) -> Tensor:
    """Return the same distance as `census_distance`, but summed over the window and including borders: (N, 1, H, W),
    from 0 to the number of pixels in the window.
    """
    return _differing(first, second, radius, luma, 1.0).sum(dim=1, keepdim=True)


def inner(maps: Tensor, border: int) -> Tensor:
    """Return 1 for pixels at least `border` pixels inside the map, otherwise 0, for maps of shape (N, C, H, W)."""
    return F.pad(torch.ones_like(maps[:, :, border:-border, border:-border]), [border] * 4)


def robust(differences: Tensor, exponent: float = 0.4) -> Tensor:
    """Return (|x| + 0.01)^q, a robust penalty that reduces the weight of large differences (Liu et al., DDFlow, AAAI
    2019)."""
    return (differences.abs() + 0.01) ** exponent


def _mean(maps: Tensor) -> Tensor:
    return F.avg_pool2d(maps, 3, stride=1)


def _differing(first: Tensor, second: Tensor, radius: int, luma: Luma, levels: float) -> Tensor:
    """Return the difference at each position of the two windows around a pixel, 0..1: (N, (2 radius + 1)^2, H, W)."""
    squared = (_census(first, radius, luma, levels) - _census(second, radius, luma, levels)).square()
    return squared / (0.1 + squared)


def _census(image: Tensor, radius: int, luma: Luma, levels: float) -> Tensor:
    """Return the values of each pixel's window minus the pixel's value, softly limited to -1..1: (N, (2 radius + 1)^2,
    H, W)."""
    grey = levels * (image * image.new_tensor(luma).view(1, 3, 1, 1)).sum(dim=1, keepdim=True)
    side = 2 * radius + 1
    windows = F.unfold(grey, side, padding=radius).unflatten(2, grey.shape[2:])
    difference = windows - grey
    return difference / (0.81 + difference.square()).sqrt()
