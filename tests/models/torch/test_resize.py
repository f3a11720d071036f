"""Resizing a flow field also scales its vectors."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.torch.model import resize, resize_flow

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("size", [(12, 14), (11, 13), (3, 20), (6, 7)])
def test_a_linear_map_stays_linear_from_corner_to_corner(size):
    y, x = np.mgrid[:6, :7].astype(np.float64)
    maps = torch.from_numpy(np.stack((2 * x - y, x + 3 * y)))[None]
    rows, columns = np.linspace(0, 5, size[0])[:, None], np.linspace(0, 6, size[1])[None, :]
    expected = np.stack((2 * columns - rows, columns + 3 * rows))
    np.testing.assert_allclose(resize(maps, size)[0], expected, atol=1e-5)
    ratios = np.array([size[1] / 7, size[0] / 6])[:, None, None]
    np.testing.assert_allclose(resize_flow(maps, size)[0], expected * ratios, rtol=1e-5, atol=1e-5)
