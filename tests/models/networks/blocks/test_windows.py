"""Windows against slices."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.windows import from_windows, to_windows

pytestmark = pytest.mark.torch


@pytest.mark.parametrize(("height", "width", "size"), [(14, 21, 7), (9, 15, 7), (3, 5, 14), (8, 8, 8)])
def test_windows_are_slices_padded_with_zeros(height, width, size):
    x = torch.arange(2 * height * width * 3, dtype=torch.float32).view(2, height, width, 3) + 1
    windows = to_windows(x, size)
    columns = -(-width // size)
    for index in range(windows.shape[1]):
        top, left = index // columns * size, index % columns * size
        piece = x[:, top : top + size, left : left + size]
        window = windows[:, index].view(2, size, size, 3)
        assert torch.equal(window[:, : piece.shape[1], : piece.shape[2]], piece)
        assert window.count_nonzero() == piece.numel()
    assert torch.equal(from_windows(windows, height, width), x)
