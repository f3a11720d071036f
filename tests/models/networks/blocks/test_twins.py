"""Properties of the image encoder that the parity packs cannot show."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.twins import PatchEmbedding, Twins

pytestmark = pytest.mark.torch


def test_dense_patches_hold_the_strided_ones():
    torch.manual_seed(0)
    embedding = PatchEmbedding(3, 8, 2)
    x = torch.rand(1, 3, 10, 14)
    dense = embedding(x, dense=True)
    assert dense.shape == (1, 10, 14, 8)
    torch.testing.assert_close(dense[:, 1::2, 1::2], embedding(x))


def test_a_map_no_multiple_of_windows_or_reductions_is_encoded():
    torch.manual_seed(0)
    net = Twins(large=False).eval()
    images = torch.rand(2, 3, 8 * 5, 8 * 9)
    with torch.no_grad():
        both = net(images)
        assert both.shape == (2, 128, 5, 9)
        torch.testing.assert_close(both[1:], net(images[1:]), atol=1e-5, rtol=1e-5)
