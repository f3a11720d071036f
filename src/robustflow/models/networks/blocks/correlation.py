"""Correlation: of all pairs, in a pyramid (RAFT, Teed and Deng 2020), and within windows (PWC-Net, Sun et al. 2018)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.checkpoint import checkpoint


def pixel_grid(like: Tensor) -> Tensor:
    """Return the coordinates (x, y) of every pixel in a map, float32 (N, 2, H, W), in pixels."""
    n, _, height, width = like.shape
    y, x = torch.meshgrid(
        torch.arange(height, device=like.device, dtype=torch.float32),
        torch.arange(width, device=like.device, dtype=torch.float32),
        indexing="ij",
    )
    return torch.stack((x, y))[None].repeat(n, 1, 1, 1)


def all_pairs(features1: Tensor, features2: Tensor) -> Tensor:
    """Compute the dot product of every pixel of map 1 with every pixel of map 2, divided by sqrt(C), in float32."""
    n, channels, height, width = features1.shape
    with torch.autocast(features1.device.type, enabled=False):
        rows = features1.float().flatten(2).transpose(1, 2)
        volume = rows @ features2.float().flatten(2) / channels**0.5
    return volume.reshape(n * height * width, 1, *features2.shape[2:])


def sample_window(maps: Tensor, centres: Tensor, radius: int) -> Tensor:
    """Sample a square window around a given centre in each map: bilinear, zero outside."""
    height, width = maps.shape[2:]
    offsets = torch.arange(-radius, radius + 1, device=centres.device, dtype=centres.dtype)
    side = len(offsets)
    x = (centres[:, 0, None, None] + offsets[None, :, None]).expand(-1, side, side)
    y = (centres[:, 1, None, None] + offsets[None, None, :]).expand(-1, side, side)
    # Half-pixel normalisation results in the same positions as align_corners=True with size - 1, without division by
    # zero for a map that is one pixel wide (the last level of a small image).
    grid = torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), dim=-1)
    return F.grid_sample(maps, grid, mode="bilinear", padding_mode="zeros", align_corners=False).flatten(2)


class CorrelationPyramid:
    """The correlation volume of two feature maps; between levels, the second map is average-pooled 2 x 2."""

    def __init__(self, features1: Tensor, features2: Tensor, levels: int = 4, radius: int = 4) -> None:
        self.radius = radius
        self.volumes = [all_pairs(features1, features2)]
        for _ in range(levels - 1):
            finest = self.volumes[-1]
            # A map smaller than two pixels cannot be pooled.
            pool = (min(2, finest.shape[2]), min(2, finest.shape[3]))
            self.volumes.append(F.avg_pool2d(finest, pool, stride=2))

    def lookup(self, coordinates: Tensor) -> Tensor:
        """Look up the correlations around the target of each pixel in map 1."""
        n, _, height, width = coordinates.shape
        centres = coordinates.float().permute(0, 2, 3, 1).reshape(n * height * width, 2)
        levels = [sample_window(volume, centres / 2**i, self.radius) for i, volume in enumerate(self.volumes)]
        return torch.cat(levels, dim=2).reshape(n, height, width, -1).permute(0, 3, 1, 2).contiguous()


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


class WindowVolume:
    """Dot products, divided by sqrt(C), with 17 x 17 pixels around an integer target, and with three pooled levels."""

    HALF, RADIUS, LEVELS = 8, 4, 4

    def __init__(self, features1: Tensor, features2: Tensor, coordinates: Tensor) -> None:
        self.shape = features1.shape
        moved = coordinates - coordinates.detach()  # zero, but carries the gradient of the target
        self.centre = coordinates.detach().round() + moved
        volume = self._correlate(features1.float(), features2.float(), moved)
        self.levels = [volume]
        for _ in range(self.LEVELS - 1):
            self.levels.append(F.avg_pool2d(self.levels[-1], 2))

    def lookup(self, coordinates: Tensor) -> Tensor:
        """Look up the correlations around `coordinates`, (N, 324, H, W), ordered as in `CorrelationPyramid`."""
        n, _, height, width = self.shape
        inside = (coordinates - self.centre + self.HALF).permute(0, 2, 3, 1).reshape(-1, 2)
        levels = [sample_window(level, inside / 2**i, self.RADIUS) for i, level in enumerate(self.levels)]
        return torch.cat(levels, dim=2).reshape(n, height, width, -1).permute(0, 3, 1, 2).contiguous()

    def _correlate(self, features1: Tensor, features2: Tensor, moved: Tensor) -> Tensor:
        n, channels, height, width = self.shape
        rows1 = features1.permute(0, 2, 3, 1).reshape(-1, channels) / channels**0.5
        rows2 = features2.permute(0, 2, 3, 1).reshape(-1, channels)
        rows2 = torch.cat((rows2, rows2.new_zeros(1, channels)))  # the last row represents all pixels outside the map
        x, y = self.centre.detach().long().permute(1, 0, 2, 3).flatten(1)
        image = torch.arange(n, device=x.device).repeat_interleave(height * width)
        side = 2 * self.HALF + 1

        def column(down: int, right: int, rows1: Tensor, rows2: Tensor) -> Tensor:
            to_y, to_x = y + down - self.HALF, x + right - self.HALF
            outside = (to_y < 0) | (to_y >= height) | (to_x < 0) | (to_x >= width)
            target = ((image * height + to_y) * width + to_x).masked_fill(outside, len(rows2) - 1)
            return (rows1 * rows2[target]).sum(dim=1)

        places = [(down, right) for down in range(side) for right in range(side)]
        if torch.is_grad_enabled() and rows1.requires_grad:  # avoids storing the products of all columns
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
    """Return the derivatives of windows with respect to the x and y of their centres, per pixel, (M, 1, S, S) each."""
    inner = wider[..., 1:-1, 1:-1]
    to_left, to_right = inner - wider[..., 1:-1, :-2], wider[..., 1:-1, 2:] - inner
    upwards, downwards = inner - wider[..., :-2, 1:-1], wider[..., 2:, 1:-1] - inner
    reach = inner.shape[-1] // 2
    offsets = torch.arange(-reach, reach + 1, device=x.device)
    before_x, before_y = (
        _gets_smaller((centre[:, None] + offsets).float(), side)[:, None] for centre, side in ((x, width), (y, height))
    )
    along_x = torch.where(before_x[..., None, :], to_left, to_right)
    return along_x, torch.where(before_y[..., None], upwards, downwards)


def _gets_smaller(pixels: Tensor, side: int) -> Tensor:
    """Return whether `grid_sample`'s normalisation to -1..1 and back makes a coordinate smaller."""
    normalised = 2 * pixels / (side - 1) - 1
    return (normalised + 1) / 2 * (side - 1) < pixels
