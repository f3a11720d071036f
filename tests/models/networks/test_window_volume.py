"""The windowed correlation matches a float64 loop written from its definition."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import numpy as np
import torch

from robustflow.models.networks.blocks.correlation import WindowVolume, pixel_grid

pytestmark = pytest.mark.torch


def test_levels_are_dot_products_around_the_rounded_target():
    generator = torch.Generator().manual_seed(0)
    features1, features2 = (torch.randn((2, 4, 5, 6), generator=generator) for _ in range(2))
    target = pixel_grid(features1) + 3 * torch.randn((2, 2, 5, 6), generator=generator)
    target[0, :, 0, 0] = 1e6  # far outside
    volume = WindowVolume(features1, features2, target)
    for n in range(2):
        for y in range(5):
            for x in range(6):
                to_x, to_y = (int(v) for v in target[n, :, y, x].round())
                window = np.zeros((17, 17))
                for row in range(17):
                    for column in range(17):
                        at_y, at_x = to_y + row - 8, to_x + column - 8
                        if 0 <= at_y < 5 and 0 <= at_x < 6:
                            window[row, column] = (features1[n, :, y, x] * features2[n, :, at_y, at_x]).sum() / 2
                index = (n * 5 + y) * 6 + x
                for level in volume.levels:
                    np.testing.assert_allclose(level[index, 0].numpy(), window, atol=1e-5)
                    side = window.shape[0] // 2
                    window = window[: 2 * side, : 2 * side].reshape(side, 2, side, 2).mean(axis=(1, 3))
