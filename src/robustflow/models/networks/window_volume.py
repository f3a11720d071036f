"""Correlation of every pixel with a window around its target, where all pairs would not fit in memory."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from .blocks.allpairs import sample_window


class WindowVolume:
    """Dot products, divided by sqrt(C), on 17 x 17 pixels around a whole-pixel target, and on three pooled levels.

    The values are those of the all-pairs volume, which at 1/4 of a KITTI image would take 3.4 GB. Rounding counts as
    the identity in the backward pass, as in FlowDiffuser: the window moves with the target (see `_slopes`), and each
    look-up moves against it.

    Args:
        features1: (N, C, H, W).
        features2: (N, C, H, W); zero outside.
        coordinates: (N, 2, H, W), (x, y) of the targets in pixels of map 2; rounded here.

    >>> from robustflow.models.networks.blocks.allpairs import CorrelationPyramid, pixel_grid
    >>> features = torch.rand(2, 1, 4, 12, 16)
    >>> target = pixel_grid(features[0]) + 1
    >>> near = WindowVolume(*features, target).lookup(target + 0.25)[:, :81]
    >>> bool(torch.allclose(near, CorrelationPyramid(*features).lookup(target + 0.25)[:, :81], atol=1e-5))
    True
    """

    HALF, RADIUS, LEVELS = 8, 4, 4

    def __init__(self, features1: Tensor, features2: Tensor, coordinates: Tensor) -> None:
        self.shape = features1.shape
        moved = coordinates - coordinates.detach()  # 0, with the gradient of the target
        self.centre = coordinates.detach().round() + moved
        volume = self._correlate(features1.float(), features2.float(), moved)
        self.levels = [volume]
        for _ in range(self.LEVELS - 1):
            self.levels.append(F.avg_pool2d(self.levels[-1], 2))

    def lookup(self, coordinates: Tensor) -> Tensor:
        """Correlations around `coordinates` (N, 2, H, W): (N, 324, H, W), ordered as `CorrelationPyramid.lookup`."""
        n, _, height, width = self.shape
        inside = (coordinates - self.centre + self.HALF).permute(0, 2, 3, 1).reshape(-1, 2)
        levels = [sample_window(level, inside / 2**i, self.RADIUS) for i, level in enumerate(self.levels)]
        return torch.cat(levels, dim=2).reshape(n, height, width, -1).permute(0, 3, 1, 2).contiguous()

    def _correlate(self, features1: Tensor, features2: Tensor, moved: Tensor) -> Tensor:
        n, channels, height, width = self.shape
        rows1 = features1.permute(0, 2, 3, 1).reshape(-1, channels) / channels**0.5
        rows2 = features2.permute(0, 2, 3, 1).reshape(-1, channels)
        rows2 = torch.cat((rows2, rows2.new_zeros(1, channels)))  # the last row is for everything outside
        x, y = self.centre.detach().long().permute(1, 0, 2, 3).flatten(1)
        image = torch.arange(n, device=x.device).repeat_interleave(height * width)
        side = 2 * self.HALF + 1

        def column(down: int, right: int, rows1: Tensor, rows2: Tensor) -> Tensor:
            to_y, to_x = y + down - self.HALF, x + right - self.HALF
            outside = (to_y < 0) | (to_y >= height) | (to_x < 0) | (to_x >= width)
            target = ((image * height + to_y) * width + to_x).masked_fill(outside, len(rows2) - 1)
            return (rows1 * rows2[target]).sum(dim=1)

        places = [(down, right) for down in range(side) for right in range(side)]
        if torch.is_grad_enabled() and rows1.requires_grad:  # each column's products would be kept for backward
            columns = [checkpoint(column, *place, rows1, rows2, use_reentrant=False) for place in places]
            volume = torch.stack(columns, dim=1).view(-1, 1, side, side)
        else:
            volume = rows1.new_empty(len(rows1), side * side)
            for index, place in enumerate(places):
                volume[:, index] = column(*place, rows1, rows2)
            volume = volume.view(-1, 1, side, side)
        if not moved.requires_grad:
            return volume
        with torch.no_grad():
            wider = F.pad(volume, (1, 1, 1, 1))
            for i in range(side):
                for down, right in ((i, -1), (i, side), (-1, i), (side, i)):
                    wider[:, 0, down + 1, right + 1] = column(down, right, rows1, rows2)
            slopes = _slopes(wider, x, y, height, width)
        for slope, along in zip(slopes, moved.permute(1, 0, 2, 3).reshape(2, -1, 1, 1, 1), strict=True):
            volume = volume + slope * along
        return volume


def _slopes(wider: Tensor, x: Tensor, y: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """How windows change when their centres move by a pixel along x and along y, each (M, 1, S, S).

    It is the derivative of bilinear sampling at whole pixels, which is one-sided: to the right or downwards, except
    where the original's float32 arithmetic lands just before a pixel, and thus on its other side.

    Args:
        wider: windows with one more pixel on each side, (M, 1, S + 2, S + 2).
        x, y: whole pixels of the centres, (M,).
        height, width: of the maps.
    """
    inner = wider[..., 1:-1, 1:-1]
    to_left, to_right = inner - wider[..., 1:-1, :-2], wider[..., 1:-1, 2:] - inner
    upwards, downwards = inner - wider[..., :-2, 1:-1], wider[..., 2:, 1:-1] - inner
    reach = inner.shape[-1] // 2
    offsets = torch.arange(-reach, reach + 1, device=x.device)
    before_x, before_y = (
        _lands_before((centre[:, None] + offsets).float(), side)[:, None] for centre, side in ((x, width), (y, height))
    )
    along_x = torch.where(before_x[..., None, :], to_left, to_right)
    return along_x, torch.where(before_y[..., None], upwards, downwards)


def _lands_before(pixels: Tensor, side: int) -> Tensor:
    """Whether a whole pixel, normalised to -1..1 for `grid_sample` and back, comes out smaller."""
    normalised = 2 * pixels / (side - 1) - 1
    return (normalised + 1) / 2 * (side - 1) < pixels
