"""What the parity packs of networks do not cover: unusual maps, precision, batches and positions."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.core.errors import ModelError
from robustflow.models.networks.blocks.correlation import CorrelationPyramid, all_pairs, pixel_grid, sample_window
from robustflow.models.networks.blocks.pwc import inside_mask, warp
from robustflow.models.networks.blocks.twins import PatchEmbedding, Twins
from robustflow.models.networks.flowdiffuser import initial_noise
from robustflow.models.networks.flowdiffuser_layers import PairTransformer
from robustflow.models.networks.sam_encoders import Attention, SamSize, SamVit

from ...refusals import refusal

pytestmark = pytest.mark.torch


def test_lookup_interpolates_in_a_level_one_pixel_wide():
    found = sample_window(torch.ones(1, 1, 1, 1), torch.tensor([[0.25, 0.0]]), radius=1)
    # x offsets vary slowest: the entries at y offset 0 from each of the three columns, at x = -0.75, 0.25, 1.25
    np.testing.assert_allclose(found.reshape(3, 3)[:, 1], [0.25, 0.75, 0.0], atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2)])
def test_small_maps_stay_finite(size):
    features = torch.randn(1, 4, *size, generator=torch.Generator().manual_seed(0))
    assert CorrelationPyramid(features, features).lookup(pixel_grid(features)).isfinite().all()


def test_volume_is_float32_under_autocast():
    features = torch.randn(1, 8, 4, 6, generator=torch.Generator().manual_seed(0))
    with torch.autocast("cpu", torch.bfloat16):
        found = all_pairs(features, features)
    assert torch.equal(found, all_pairs(features, features))


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


def test_a_lower_threshold_lets_part_of_the_border_in():
    flow = torch.full((1, 2, 4, 4), 0.0)
    flow[:, 0] = 0.25
    columns = [inside_mask(flow, threshold)[0, 0, 0].tolist() for threshold in (0.9999, 0.7, 0.8)]
    assert columns == [[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 0]]


def test_one_pixel_maps_are_fetched_without_dividing_by_zero():
    assert warp(torch.ones(1, 2, 1, 1), torch.zeros(1, 2, 1, 1)).tolist() == [[[[1.0]], [[1.0]]]]


@pytest.mark.parametrize("first_rows", [False, True])
def test_attention_adds_decomposed_relative_positions(first_rows):
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
                    # Distance 0 is at the centre of the table, or of its first 2 n - 1 rows.
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
        refusal(lambda: net(torch.zeros(1, 3, 32, 1040)), ModelError, "32x1040")


def test_pairs_of_a_batch_are_encoded_independently():
    torch.manual_seed(0)
    net = PairTransformer().eval()
    first, second = torch.randn(2, 3, 256, 11, 13).unbind()
    with torch.no_grad():
        together = net(first, second)
        alone = net(first[1:2], second[1:2])
    for found, wanted in zip(together, alone, strict=True):
        assert found.shape == first.shape
        torch.testing.assert_close(found[1:2], wanted, atol=1e-4, rtol=1e-4)


def test_the_noise_is_normal_and_named_by_seed_and_size():
    noise = initial_noise(3, 100, 120)
    assert noise.shape == (1, 2, 100, 120)
    # Four standard errors of the mean and the variance of 24 000 numbers.
    assert abs(noise.mean()) < 4 / 24000**0.5
    assert abs(noise.var() - 1) < 4 * (2 / 24000) ** 0.5
    assert not torch.equal(noise, initial_noise(4, 100, 120))
