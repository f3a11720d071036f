"""TinyViT's window attention against a float64 loop."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.tiny_vit import WindowAttention, distance_index

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("size", [7, 14])
def test_biases_are_numbered_in_the_order_their_distances_appear(size):
    pixels = [(y, x) for y in range(size) for x in range(size)]
    numbers: dict[tuple[int, int], int] = {}
    wanted = [
        [numbers.setdefault((abs(y1 - y2), abs(x1 - x2)), len(numbers)) for y2, x2 in pixels] for y1, x1 in pixels
    ]
    assert distance_index(size).tolist() == wanted


def test_heads_hold_query_key_and_value_side_by_side():
    torch.manual_seed(0)
    attention = WindowAttention(6, heads=2, window=2)
    with torch.no_grad():
        attention.attention_biases.normal_()
        x = torch.randn(1, 2, 3, 6)
        found = attention(x)
        padded = torch.zeros(1, 2, 4, 6)
        padded[:, :, :3] = x
        for left in (0, 2):
            tokens = attention.norm(padded[0, :, left : left + 2].reshape(4, 6))
            qkv = attention.qkv(tokens).double()
            mixed = []
            for head in range(2):
                query, key, value = qkv[:, 9 * head : 9 * head + 9].split(3, dim=1)
                logits = torch.zeros(4, 4, dtype=torch.float64)
                for i in range(4):
                    for j in range(4):
                        number = 2 * abs(i // 2 - j // 2) + abs(i % 2 - j % 2)
                        logits[i, j] = (query[i] * key[j]).sum() / 3**0.5 + attention.attention_biases[head, number]
                mixed.append(logits.softmax(dim=1) @ value)
            wanted = torch.cat(mixed, dim=1) @ attention.proj.weight.double().T + attention.proj.bias.double()
            part = found[0, :, left : left + 2]
            torch.testing.assert_close(part.double(), wanted.view(2, 2, 6)[:, : part.shape[1]], atol=1e-6, rtol=1e-5)
