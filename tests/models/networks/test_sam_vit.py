"""SAM's attention against a float64 loop, and the edge of its position tables."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.errors import ModelError
from robustflow.models.networks.sam_vit import Attention, SamSize, SamVit

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("first_rows", [False, True])
def test_attention_with_decomposed_relative_positions(first_rows):
    torch.manual_seed(0)
    height, width, grid, heads, channels = 3, 4, 5, 2, 8
    attention = Attention(channels, heads, grid, first_rows)
    with torch.no_grad():
        for table in (attention.rel_pos_h, attention.rel_pos_w):
            table.normal_()
        tokens = torch.randn(1, height * width, channels)
        found = attention(tokens, height, width)[0]
        query, key, value = attention.qkv(tokens)[0].double().chunk(3, dim=1)
        mixed = torch.zeros(height * width, channels, dtype=torch.float64)
        for head in range(heads):
            part = slice(4 * head, 4 * head + 4)
            for i in range(height * width):
                logits = torch.zeros(height * width, dtype=torch.float64)
                for j in range(height * width):
                    dy, dx = i // width - j // width, i % width - j % width
                    # The middle of the table, or of its first 2 n - 1 rows, stands for distance 0.
                    row = attention.rel_pos_h[dy + (height - 1 if first_rows else grid - 1)].double()
                    column = attention.rel_pos_w[dx + (width - 1 if first_rows else grid - 1)].double()
                    q = query[i, part]
                    logits[j] = (q * key[j, part]).sum() / 2 + (q * row).sum() + (q * column).sum()
                mixed[i, part] = logits.softmax(dim=0) @ value[:, part]
        wanted = mixed @ attention.proj.weight.double().T + attention.proj.bias.double()
    torch.testing.assert_close(found.double(), wanted, atol=1e-6, rtol=1e-5)


def test_beyond_1024_pixels_there_are_no_positions():
    net = SamVit(SamSize(width=8, depth=1, heads=2, global_blocks=(0,)))
    with torch.no_grad():
        assert net(torch.zeros(1, 3, 32, 1024)).shape == (1, 256, 2, 64)
        with pytest.raises(ModelError, match=r"1024 x 1024 pixels, not for 32 x 1040; predict in tiles"):
            net(torch.zeros(1, 3, 32, 1040))
