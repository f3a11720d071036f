"""Shifted windows against a loop over pixels, with padding on every side."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.attention import attend
from robustflow.models.networks.pair_transformer import PairTransformer, WindowBlock

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("shift", [0, 4])
def test_pixels_meet_inside_a_window_that_does_not_wrap(shift):
    torch.manual_seed(0)
    block = WindowBlock(shift)
    height, width = 16, 24
    labels = torch.zeros(height, width, dtype=torch.long)
    labels[:5] = labels[:, :1] = labels[:, 22:] = 1
    x = torch.randn(2, height, width, 256)
    with torch.no_grad():
        found = block(x, labels)
        y, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        windows = torch.stack(((y - shift) // 8, (column - shift) // 8, labels), dim=-1).reshape(-1, 3)
        together = (windows[:, None] == windows).all(dim=-1)
        normed = block.layer_norm1(x).flatten(1, 2)
        attention = block.self_attn
        bias = torch.zeros(together.shape).masked_fill(~together, float("-inf"))
        mixed = attend(attention.q(normed), attention.k(normed), attention.v(normed), bias=bias)
        wanted = x.flatten(1, 2) + attention.proj(mixed)
        wanted = wanted + block.mlp(block.layer_norm2(wanted))
    torch.testing.assert_close(found.flatten(1, 2), wanted, atol=1e-5, rtol=1e-5)


def test_each_pair_is_transformed_by_itself():
    torch.manual_seed(0)
    net = PairTransformer().eval()
    first, second = torch.randn(2, 3, 256, 11, 13).unbind()
    with torch.no_grad():
        together = net(first, second)
        alone = net(first[1:2], second[1:2])
    for found, wanted in zip(together, alone, strict=True):
        assert found.shape == first.shape
        torch.testing.assert_close(found[1:2], wanted, atol=1e-4, rtol=1e-4)
