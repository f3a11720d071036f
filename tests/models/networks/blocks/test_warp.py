"""Warping against a float64 loop."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.warp import inside_mask, warp

from .bilinear import bilinear

pytestmark = pytest.mark.torch
HEIGHT, WIDTH = 6, 9


def maps_and_flow():
    rng = np.random.default_rng(0)
    return rng.standard_normal((2, 3, HEIGHT, WIDTH)), rng.uniform(-5, 5, (2, 2, HEIGHT, WIDTH))


@pytest.mark.parametrize("padding", ["zeros", "border"])
@pytest.mark.parametrize("align_corners", [True, False])
def test_every_pixel_is_fetched_where_the_flow_points(padding, align_corners):
    maps, flow = maps_and_flow()
    expected = np.zeros_like(maps)
    for n, c, y, x in np.ndindex(maps.shape):
        to_x, to_y = x + flow[n, 0, y, x], y + flow[n, 1, y, x]
        if not align_corners:
            # Coordinates divided by size - 1 but read as fractions of the full width, half a pixel outwards.
            to_x, to_y = to_x * WIDTH / (WIDTH - 1) - 0.5, to_y * HEIGHT / (HEIGHT - 1) - 0.5
        if padding == "border":
            to_x, to_y = np.clip(to_x, 0, WIDTH - 1), np.clip(to_y, 0, HEIGHT - 1)
        expected[n, c, y, x] = bilinear(maps[n, c], to_x, to_y)
    found = warp(torch.from_numpy(maps), torch.from_numpy(flow), padding, align_corners)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_the_mask_is_where_all_four_neighbours_are_inside():
    _, flow = maps_and_flow()
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    to_x, to_y = x + flow[:, 0], y + flow[:, 1]
    inside = (to_x >= 0) & (to_x <= WIDTH - 1) & (to_y >= 0) & (to_y <= HEIGHT - 1)
    found = inside_mask(torch.from_numpy(flow).float(), 0.9999)
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(found[:, 0].numpy(), inside)


def test_a_lower_threshold_lets_part_of_the_border_in():
    flow = torch.full((1, 2, 4, 4), 0.0)
    flow[:, 0] = 0.25
    columns = [inside_mask(flow, threshold)[0, 0, 0].tolist() for threshold in (0.9999, 0.7, 0.8)]
    assert columns == [[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 0]]


def test_one_pixel_maps_are_fetched_without_dividing_by_zero():
    assert warp(torch.ones(1, 2, 1, 1), torch.zeros(1, 2, 1, 1)).tolist() == [[[[1.0]], [[1.0]]]]
