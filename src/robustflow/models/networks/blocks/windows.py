"""Split a map into square windows of tokens and merge them again, for attention within windows (Swin, Twins, SAM)."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor


def to_windows(x: Tensor, size: int) -> Tensor:
    """Split a map into windows, row by row, after zero-padding it at the bottom and on the right to a multiple of the
    window size.
    """
    n, height, width, channels = x.shape
    x = F.pad(x, (0, 0, 0, -width % size, 0, -height % size))
    rows, columns = x.shape[1] // size, x.shape[2] // size
    x = x.reshape(n, rows, size, columns, size, channels).transpose(2, 3)
    return x.reshape(n, rows * columns, size * size, channels)


def from_windows(windows: Tensor, height: int, width: int) -> Tensor:
    """Merge `windows` from `to_windows` into the map (N, height, width, C), and remove the padding."""
    n, _, area, channels = windows.shape
    size = round(area**0.5)
    rows, columns = -(-height // size), -(-width // size)
    x = windows.reshape(n, rows, columns, size, size, channels).transpose(2, 3)
    return x.reshape(n, rows * size, columns * size, channels)[:, :height, :width]
