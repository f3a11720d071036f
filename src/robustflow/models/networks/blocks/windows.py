"""Cut a map into square windows of tokens and put it back together (Swin, Twins and SAM attend inside windows)."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor


def to_windows(x: Tensor, size: int) -> Tensor:
    """Windows, row by row, of a map padded with zeros at the bottom and right to whole windows.

    Args:
        x: (N, H, W, C).
        size: side of a window.

    Returns:
        (N, windows, size * size, C).

    >>> import torch
    >>> to_windows(torch.zeros(2, 10, 8, 3), 7).shape
    torch.Size([2, 4, 49, 3])
    """
    n, height, width, channels = x.shape
    x = F.pad(x, (0, 0, 0, -width % size, 0, -height % size))
    rows, columns = x.shape[1] // size, x.shape[2] // size
    x = x.reshape(n, rows, size, columns, size, channels).transpose(2, 3)
    return x.reshape(n, rows * columns, size * size, channels)


def from_windows(windows: Tensor, height: int, width: int) -> Tensor:
    """The map (N, height, width, C) whose `to_windows` gave `windows`; the padding is removed.

    >>> import torch
    >>> x = torch.rand(2, 10, 8, 3)
    >>> torch.equal(from_windows(to_windows(x, 7), 10, 8), x)
    True
    """
    n, _, area, channels = windows.shape
    size = round(area**0.5)
    rows, columns = -(-height // size), -(-width // size)
    x = windows.reshape(n, rows, columns, size, size, channels).transpose(2, 3)
    return x.reshape(n, rows * size, columns * size, channels)[:, :height, :width]
