import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from robustflow.metrics.regions import edge_distance, motion_edges

from . import naive
from .strategies import flows, masks, shapes


@given(st.data())
def test_edges_and_distances_equal_the_naive_loop(data):
    shape = data.draw(shapes)
    flow, valid = data.draw(flows(shape)), data.draw(masks(shape))
    expected = naive.edges(flow, valid)
    edges = motion_edges(np.where(valid[..., None], flow, np.float32(np.nan)), valid)
    assert {tuple(p) for p in np.argwhere(edges).tolist()} == expected
    distance = edge_distance(edges)
    for y, x in naive.pixels(valid):
        assert distance[y, x] == naive.edge_distance(y, x, expected)


def _step(jump, background, gap=1):
    """One row with two motions, `gap` pixels apart."""
    flow = np.zeros((1, 20, 2), np.float32)
    flow[..., 0] = background
    flow[:, 10:, 0] += jump
    valid = np.ones((1, 20), np.bool_)
    valid[:, 10 - gap + 1 : 10] = False
    edges = motion_edges(flow, valid)
    np.testing.assert_array_equal(motion_edges(flow.transpose(1, 0, 2), valid.T), edges.T)
    return edges


def test_a_jump_counts_above_one_pixel_and_above_five_percent():
    assert not _step(1.0, 0).any()
    assert _step(1.01, 0).sum() == 2
    assert not _step(1.5, 100).any()
    assert not _step(5.2, 100).any()
    assert not _step(5.0, 95).any()
    assert _step(5.3, 100).sum() == 2


def test_a_hole_is_bridged_up_to_five_pixels_and_asks_for_a_larger_jump():
    assert np.argwhere(_step(8, 0, gap=5)[0]).ravel().tolist() == [5, 10]
    assert not _step(4, 0, gap=5).any()
    assert not _step(60, 0, gap=6).any()


@pytest.mark.parametrize("shape", [(375, 1242), (900, 800), (1, 700)])
def test_edge_distances_equal_scipy(shape):
    edges = np.random.default_rng(0).random(shape) < 3e-5
    edges[0, 0] = True
    np.testing.assert_array_equal(edge_distance(edges), distance_transform_edt(~edges))
