"""Attention and position codes against float64 loops over their definitions."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.attention import attend, linear_sine
from robustflow.models.networks.blocks.context_attention import context_attention, gather

pytestmark = pytest.mark.torch


def naive(query, key, value, bias):
    """One head, in float64: lists of vectors."""
    rows = []
    for i, q in enumerate(query.double()):
        logits = torch.stack([(q * k).sum() for k in key.double()]) / len(q) ** 0.5 + bias[i].double()
        weights = torch.exp(logits - logits.max())
        rows.append((weights[:, None] * value.double()).sum(dim=0) / weights.sum())
    return torch.stack(rows)


def test_attend_is_softmax_attention_of_each_head():
    generator = torch.Generator().manual_seed(0)
    query, key, value, bias = (
        torch.randn(shape, generator=generator) for shape in ((2, 5, 12), (2, 7, 12), (2, 7, 9), (2, 3, 5, 7))
    )
    found = attend(query, key, value, heads=3, bias=bias)
    for n in range(2):
        for head in range(3):
            q, k = (t[n, :, 4 * head : 4 * head + 4] for t in (query, key))
            wanted = naive(q, k, value[n, :, 3 * head : 3 * head + 3], bias[n, head])
            torch.testing.assert_close(found[n, :, 3 * head : 3 * head + 3].double(), wanted, atol=1e-6, rtol=1e-5)


def test_context_attention_gathers_like_a_single_head():
    generator = torch.Generator().manual_seed(1)
    query_key = torch.randn((2, 12, 3, 4), generator=generator)
    values = torch.randn((2, 5, 3, 4), generator=generator)
    found = gather(context_attention(query_key), values).flatten(2)
    for n in range(2):
        query, key = query_key[n].flatten(1).T.chunk(2, dim=1)
        wanted = naive(query, key, values[n].flatten(1).T, torch.zeros(12, 12)).T
        torch.testing.assert_close(found[n].double(), wanted, atol=1e-6, rtol=1e-5)


def test_the_code_is_sines_and_cosines_at_growing_frequency():
    code = linear_sine(torch.tensor([[30.0, 7.0]]), 16)[0]
    for band in range(4):
        for axis, place in ((0, 30.0), (1, 7.0)):
            angle = torch.tensor(3.14 * place * band / 200)
            assert abs(code[8 * axis + band] - angle.sin()) < 1e-6
            assert abs(code[8 * axis + 4 + band] - angle.cos()) < 1e-6
