"""Depth of samples: completed, carried to frame 2, and read from the files of data sets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import binary_erosion

from robustflow.datasets import load_dataset
from robustflow.datasets.base import Depths
from robustflow.datasets.depth import carried, completed, scene_depth
from robustflow.datasets.shapes.render import layer_depths
from robustflow.datasets.still import Still
from robustflow.errors import DataError
from robustflow.sample import Camera

CAMERA = Camera((10.0, 10.0), (2.0, 2.0))


def filled_in_plain_python(depth):
    """The stated method, pixel by pixel."""
    known = np.isfinite(depth) & (depth > 0)
    rows = {}
    for y in np.flatnonzero(known.any(axis=1)):
        at = np.flatnonzero(known[y])
        beside = [(at[at <= x][-1:], at[at >= x][:1]) for x in range(depth.shape[1])]
        rows[y] = [max(depth[y, place] for place in (*left, *right)) for left, right in beside]
    out = np.empty(depth.shape)
    for y in range(depth.shape[0]):
        above, below = [r for r in rows if r <= y][-1:], [r for r in rows if r >= y][:1]
        out[y] = np.max([rows[r] for r in (*above, *below)], axis=0)
    return out


@settings(max_examples=150, deadline=None)
@given(
    arrays.arrays(
        np.float32,
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=7),
        elements=st.sampled_from([0.0, 0.0, 0.0, np.nan, np.inf, 1.0, 2.5, 80.0]),
    )
)
def test_holes_take_the_farther_of_their_measured_neighbours(values):
    known = np.isfinite(values) & (values > 0)
    if not known.any():
        with pytest.raises(DataError, match="only holes"):
            completed(values)
        return
    depth, measured = completed(values)
    np.testing.assert_array_equal(measured, known)
    np.testing.assert_array_equal(depth, filled_in_plain_python(values))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((4, 4), np.nan), "only holes"),
        (np.zeros((4, 4)), "only holes"),
        (np.full((4, 4), -1.0), "negative depths"),
        (np.ones((4, 5)), "5x4, the frames are 4x4"),
        (np.ones((4, 4, 1)), "1x4x4, the frames are 4x4"),
    ],
)
def test_a_depth_map_that_cannot_be_one_is_refused_in_a_sentence(values, message):
    with pytest.raises(DataError, match=message):
        scene_depth(np.ones((4, 4)), values, CAMERA, "maps/7", (4, 4))


@pytest.mark.parametrize(("metres", "warned"), [(0.05, True), (0.1, False), (9e3, False), (2e4, True)])
def test_a_median_depth_of_another_unit_is_warned_of(metres, warned, recwarn):
    scene_depth(np.full((4, 4), metres), np.full((4, 4), metres), CAMERA, "maps/7", (4, 4))
    assert any("check the unit" in str(each.message) for each in recwarn) is warned


def test_of_points_that_meet_in_frame_2_the_nearest_is_seen():
    flow = np.zeros((1, 4, 2), np.float32)
    flow[0, :, 0] = 2, 1, 0, -1
    found = carried(np.array([[5.0, 3.0, 9.0, 1.0]]), flow, np.array([[True, True, True, False]]))
    assert found.tolist() == [[0.0, 0.0, 3.0, 0.0]]


def test_shapes_have_the_depth_of_the_layer_that_is_seen_in_both_frames():
    data = load_dataset("shapes", pairs=3, size="96x128")
    assert isinstance(data, Depths)
    for sample in data:
        depth = data.depth(sample)
        assert depth.maps[0].max() == 100
        assert 5 <= depth.maps[0].min() < 100
        rows, columns = np.mgrid[:96, :128]
        there = np.rint(np.dstack([columns, rows]) + sample.flow).astype(int)
        seen = ~sample.occluded
        follows = depth.maps[1][there[seen][:, 1], there[seen][:, 0]] == depth.maps[0][seen]
        assert follows.mean() > 0.97  # all but pixels at the edges of layers
        inside = ((there >= 0) & (there < (128, 96))).all(axis=2)
        hidden = binary_erosion(sample.occluded, iterations=2) & inside
        nearer = depth.maps[1][there[hidden][:, 1], there[hidden][:, 0]] < depth.maps[0][hidden]
        assert nearer.mean() > 0.95


def test_layers_run_from_5_to_100_metres_evenly_in_inverse_depth():
    inverse = 1 / layer_depths(6).astype(float)
    np.testing.assert_allclose(np.diff(inverse), (0.01 - 0.2) / 5, rtol=1e-5)
    assert layer_depths(1).tolist() == [5.0]


def test_motorcycle_moves_by_its_baseline_as_its_disparity_says():
    """Back-projected, moved by the camera's motion and projected again, each pixel is where the true flow takes it."""
    data = load_dataset("motorcycle")
    sample = data["motorcycle"]
    depth = data.depth(sample)
    valid = depth.measured[0]
    np.testing.assert_array_equal(valid, sample.valid)
    rows, columns = np.nonzero(valid)
    fx, fy, cx, cy = depth.camera.intrinsics(0)
    metres = depth.maps[0][valid].astype(float)
    points = np.stack([(columns - cx) * metres / fx, (rows - cy) * metres / fy, metres])
    moved = depth.camera.rotation @ points + depth.camera.translation[:, None]
    fx, fy, cx, cy = depth.camera.intrinsics(1)
    np.testing.assert_allclose(fx * moved[0] / moved[2] + cx - columns, sample.flow[valid, 0], atol=2e-4)
    np.testing.assert_allclose(fy * moved[1] / moved[2] + cy, rows, atol=1e-4)
    assert 2 < metres.min() < metres.max() < 6  # a room


def test_motorcycles_second_frame_has_the_depth_of_what_it_shows():
    data = load_dataset("motorcycle")
    sample = data["motorcycle"]
    depth = data.depth(sample)
    rows, columns = np.nonzero(sample.valid)
    there = np.rint(columns + sample.flow[sample.valid, 0]).astype(int)
    inside = (there >= 0) & (there < 741)
    second, first = depth.maps[1][rows[inside], there[inside]], depth.maps[0][sample.valid][inside]
    assert (second <= first).all()  # nothing that is farther than what it covers
    assert (second == first).mean() > 0.9
    assert depth.measured[1].mean() > 0.8


def test_a_still_scene_has_the_depth_of_its_frame_twice_and_a_camera_at_rest():
    data = load_dataset("motorcycle")
    pair = data.depth(data["motorcycle"])
    still = Still(data, ["motorcycle"])
    for which, sample in enumerate(still):
        depth = still.depth(sample)
        for each in depth.maps:
            np.testing.assert_array_equal(each, pair.maps[which])
        assert not depth.camera.translation.any()
        assert depth.camera.intrinsics(1) == pair.camera.intrinsics(which)
        assert still.depth_files(sample.key) == data.files("motorcycle")[2:]
