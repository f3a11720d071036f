"""Correlation of every pixel with a window around its target, where all pairs would not fit in memory."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..blocks.allpairs import sample_window


class WindowVolume:
    """Dot products, divided by sqrt(C), on 17 x 17 pixels around a whole-pixel target, and on three pooled levels.

    The values are those of the all-pairs volume, which at 1/4 of a KITTI image would take 3.4 GB.

    Args:
        features1: (N, C, H, W).
        features2: (N, C, H, W); zero outside.
        coordinates: (N, 2, H, W), (x, y) of the targets in pixels of map 2; rounded here.

    >>> from robustflow.models.own.blocks.allpairs import CorrelationPyramid, pixel_grid
    >>> features = torch.rand(2, 1, 4, 12, 16)
    >>> target = pixel_grid(features[0]) + 1
    >>> near = WindowVolume(*features, target).lookup(target + 0.25)[:, :81]
    >>> bool(torch.allclose(near, CorrelationPyramid(*features).lookup(target + 0.25)[:, :81], atol=1e-5))
    True
    """

    HALF, RADIUS, LEVELS = 8, 4, 4

    def __init__(self, features1: Tensor, features2: Tensor, coordinates: Tensor) -> None:
        self.shape = features1.shape
        self.centre = coordinates.round()
        volume = self._correlate(features1.float(), features2.float())
        self.levels = [volume]
        for _ in range(self.LEVELS - 1):
            self.levels.append(F.avg_pool2d(self.levels[-1], 2))

    def lookup(self, coordinates: Tensor) -> Tensor:
        """Correlations around `coordinates` (N, 2, H, W): (N, 324, H, W), ordered as `CorrelationPyramid.lookup`."""
        n, _, height, width = self.shape
        inside = (coordinates - self.centre + self.HALF).permute(0, 2, 3, 1).reshape(-1, 2)
        levels = [sample_window(level, inside / 2**i, self.RADIUS) for i, level in enumerate(self.levels)]
        return torch.cat(levels, dim=2).reshape(n, height, width, -1).permute(0, 3, 1, 2).contiguous()

    def _correlate(self, features1: Tensor, features2: Tensor) -> Tensor:
        n, channels, height, width = self.shape
        rows1 = features1.permute(0, 2, 3, 1).reshape(-1, channels) / channels**0.5
        rows2 = features2.permute(0, 2, 3, 1).reshape(-1, channels)
        rows2 = torch.cat((rows2, rows2.new_zeros(1, channels)))  # the last row stands for everything outside
        x, y = self.centre.long().permute(1, 0, 2, 3).flatten(1)
        image = torch.arange(n, device=x.device).repeat_interleave(height * width)
        side = 2 * self.HALF + 1

        def column(index: int, rows1: Tensor, rows2: Tensor) -> Tensor:
            to_y, to_x = y + index // side - self.HALF, x + index % side - self.HALF
            outside = (to_y < 0) | (to_y >= height) | (to_x < 0) | (to_x >= width)
            target = ((image * height + to_y) * width + to_x).masked_fill(outside, len(rows2) - 1)
            return (rows1 * rows2[target]).sum(dim=1)

        if torch.is_grad_enabled() and rows1.requires_grad:  # each column's products would be kept for backward
            columns = [checkpoint(column, i, rows1, rows2, use_reentrant=False) for i in range(side * side)]
            return torch.stack(columns, dim=1).view(-1, 1, side, side)
        volume = rows1.new_empty(len(rows1), side * side)
        for index in range(side * side):
            volume[:, index] = column(index, rows1, rows2)
        return volume.view(-1, 1, side, side)
