"""The terms of losses without labels: warping, smoothness, photometric differences, and occlusion.

Boundary-dilated warping samples the targets of a crop's flow from the uncropped frame, so that pixels that leave the
crop are not lost (Luo et al., "OccInpFlow", 2020, adopted by UPFlow).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ...models.networks.blocks.correlation import pixel_grid
from ...models.networks.blocks.pwc import warp


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


def smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """Return the mean weighted difference of neighbouring flow vectors, a scalar scaled as in ARFlow."""
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in steps(image))
    x, y = steps(flow)
    if second_order:
        x, y = steps(x)[0], steps(y)[1]
        weight_x, weight_y = weight_x[:, :, :, 1:], weight_y[:, :, 1:]
    else:
        x, y = x / 2, y / 2
    return (weight_x * x.abs()).mean() / 2 + (weight_y * y.abs()).mean() / 2


def robust_smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """Return BrightFlow's smoothness, a scalar: sqrt(d^2 + 0.001^2) of each difference d, summed over both
    components.
    """
    x, y = steps(flow)
    if second_order:
        x, y = steps(x)[0], steps(y)[1]
        edges = image[:, :, :, 2:] - image[:, :, :, :-2], image[:, :, 2:] - image[:, :, :-2]
    else:
        edges = steps(image)
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in edges)
    along_x, along_y = (weight_x * charbonnier(x)).sum(dim=1).mean(), (weight_y * charbonnier(y)).sum(dim=1).mean()
    return (along_x + along_y) / 2


def charbonnier(differences: Tensor) -> Tensor:
    """Return sqrt(x^2 + 0.001^2), a smooth absolute value."""
    return (differences.square() + 1e-6).sqrt()


def steps(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Return the differences of neighbours along x and along y."""
    return maps[:, :, :, 1:] - maps[:, :, :, :-1], maps[:, :, 1:] - maps[:, :, :-1]


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


def seen_by_check(forward: Tensor, backward: Tensor) -> Tensor:
    """Return 1 where the flows in both directions, float (N, 2, H, W), in pixels, are consistent: |f + b|^2 <= 0.01
    (|f|^2 + |b|^2) + 0.5 (Sundaram et al., ECCV 2010); otherwise 0, float (N, 1, H, W)."""
    returned = warp(backward, forward)
    off = (forward + returned).square().sum(dim=1, keepdim=True)
    length = forward.square().sum(dim=1, keepdim=True) + returned.square().sum(dim=1, keepdim=True)
    return (off <= 0.01 * length + 0.5).to(forward.dtype)


def seen_by_splat(backward: Tensor) -> Tensor:
    """Return 1 where the pixels of the other frame, moved by the backward flow, cover at least a fifth of a pixel (Wang
    et al., CVPR 2018); shape and values as in `seen_by_check`."""
    return (coverage(backward) >= 0.2).to(backward.dtype)


def coverage(flow: Tensor, values: Tensor | None = None) -> Tensor:
    """Move every pixel by its flow, splat its value bilinearly, and return the sum at each pixel, (N, 1, H, W)."""
    count, _, height, width = flow.shape
    x, y = (pixel_grid(flow) + flow).flatten(2).unbind(dim=1)
    left, top = x.floor(), y.floor()
    carried = torch.ones_like(x) if values is None else values.flatten(1)
    landed = flow.new_zeros(count, height * width)
    for column in (left, left + 1):
        for row in (top, top + 1):
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            share = torch.where(inside, (1 - (x - column).abs()) * (1 - (y - row).abs()), 0.0) * carried
            place = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
            landed = landed.scatter_add(1, place.long(), share)
    return landed.view(count, 1, height, width)
