"""All-pairs correlation: the pyramid and the lookup of windows in it (RAFT, Teed and Deng 2020, section 3.2).
Correlation of each pixel with a square window around it in a second map (PWC-Net's cost volume, Sun et al.
2018).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


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
