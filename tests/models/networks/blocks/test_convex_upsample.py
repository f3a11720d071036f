"""Convex upsampling against a float64 loop."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.convex_upsample import convex_upsample

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("factor", [4, 8])
def test_every_fine_pixel_is_its_weighted_mean(factor):
    rng = np.random.default_rng(0)
    flow, mask = rng.standard_normal((2, 3, 4)), rng.standard_normal((9, factor, factor, 3, 4))
    weights = np.exp(mask) / np.exp(mask).sum(axis=0)
    padded = np.pad(flow, ((0, 0), (1, 1), (1, 1)))
    expected = np.zeros((2, 3 * factor, 4 * factor))
    for y, x in np.ndindex(3 * factor, 4 * factor):
        (row, dy), (column, dx) = divmod(y, factor), divmod(x, factor)
        for k in range(9):
            neighbour = padded[:, row + k // 3, column + k % 3]
            expected[:, y, x] += factor * weights[k, dy, dx, row, column] * neighbour
    found = convex_upsample(
        torch.from_numpy(flow)[None], torch.from_numpy(mask).reshape(1, 9 * factor**2, 3, 4), factor
    )
    np.testing.assert_allclose(found[0], expected, atol=1e-5)
