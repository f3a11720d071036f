"""The correlation pyramid against a float64 loop that follows the paper's definition."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.allpairs import CorrelationPyramid, all_pairs, pixel_grid, sample_window

from .bilinear import bilinear

pytestmark = pytest.mark.torch


def naive_lookup(features1, features2, coordinates, levels, radius):
    channels, height, width = features1.shape
    out = np.zeros((levels * (2 * radius + 1) ** 2, height, width))
    for y in range(height):
        for x in range(width):
            level_map = np.einsum("c,chw->hw", features1[:, y, x], features2) / np.sqrt(channels)
            channel = 0
            for level in range(levels):
                cx, cy = coordinates[:, y, x] / 2**level
                for dx in range(-radius, radius + 1):
                    for dy in range(-radius, radius + 1):
                        out[channel, y, x] = bilinear(level_map, cx + dx, cy + dy)
                        channel += 1
                h, w = level_map.shape[0] // 2, level_map.shape[1] // 2
                level_map = level_map[: 2 * h, : 2 * w].reshape(h, 2, w, 2).mean(axis=(1, 3))
    return out


def test_lookup_is_the_definition():
    rng = np.random.default_rng(0)
    features1, features2 = rng.standard_normal((2, 2, 5, 9, 11))
    coordinates = rng.uniform(-4, 14, (2, 2, 9, 11))
    pyramid = CorrelationPyramid(torch.from_numpy(features1), torch.from_numpy(features2), levels=3, radius=2)
    found = pyramid.lookup(torch.from_numpy(coordinates)).numpy()
    for sample in range(2):
        expected = naive_lookup(features1[sample], features2[sample], coordinates[sample], 3, 2)
        np.testing.assert_allclose(found[sample], expected, atol=2e-5)


def test_windows_of_a_level_one_pixel_wide():
    found = sample_window(torch.ones(1, 1, 1, 1), torch.tensor([[0.25, 0.0]]), radius=1)
    # x offset major: the row y offset 0 of each of the three columns, at x = -0.75, 0.25, 1.25
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


def test_pixel_grid_counts_columns_then_rows():
    grid = pixel_grid(torch.zeros(2, 3, 4, 5))
    assert grid.shape == (2, 2, 4, 5)
    assert grid[1, :, 3, 2].tolist() == [2.0, 3.0]
