"""Local correlation against a float64 loop."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.local_correlation import local_correlation

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("radius", [1, 2, 4])
def test_each_channel_is_one_displacement(radius):
    features1, features2 = np.random.default_rng(0).standard_normal((2, 2, 5, 6, 7))
    side = 2 * radius + 1
    expected = np.zeros((2, side**2, 6, 7))
    for n, y, x in np.ndindex(2, 6, 7):
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                if 0 <= y + dy < 6 and 0 <= x + dx < 7:
                    product = features1[n, :, y, x] * features2[n, :, y + dy, x + dx]
                    expected[n, (dy + radius) * side + dx + radius, y, x] = product.mean()
    found = local_correlation(torch.from_numpy(features1), torch.from_numpy(features2), radius)
    np.testing.assert_allclose(found, expected, atol=1e-6)
