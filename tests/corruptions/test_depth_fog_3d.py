"""Fog in three dimensions compared with Koschmieder's law in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.corruptions import corrupt, load_corruption
from robustflow.datasets import load_dataset
from robustflow.errors import DataError, UsageError
from robustflow.random.rng import Rng
from robustflow.sample import Camera, SceneDepth

from .pictures import picture, scene

VISIBILITIES = (1000.0, 500.0, 250.0, 125.0, 60.0)


@settings(max_examples=60, deadline=None)
@given(
    severity=st.integers(1, 5),
    seed=st.integers(0, 2**32),
    depths=st.lists(st.floats(0.01, 1e6), min_size=2, max_size=2),
)
def test_fog_is_within_a_grey_level_of_the_formula_in_float64(severity, seed, depths):
    rng = np.random.default_rng(seed)
    low, high = sorted(depths)
    maps = tuple(np.exp(rng.uniform(np.log(low), np.log(high), (20, 30))).astype(np.float32) for _ in range(2))
    known = np.ones((20, 30), bool)
    depth = SceneDepth(maps, (known, known), Camera((30.0, 30.0), (15.0, 10.0)))
    frames = picture(20, 30), picture(20, 30, seed=1)
    corruption = load_corruption("fog_3d")
    state = corruption.draw_with_depth(Rng.of(seed), severity, (20, 30), depth)
    airlight = state[0].astype(np.float64)
    for index, frame in enumerate(frames):
        passed = np.exp(-3.912 / VISIBILITIES[severity - 1] * maps[index].astype(np.float64))[..., None]
        expected = passed * frame + (1 - passed) * airlight
        assert np.abs(corruption.apply(frame, state, index) - expected).max() < 0.51


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**64 - 1))
def test_the_airlight_is_a_bright_near_grey(seed):
    red, green, blue = load_corruption("fog_3d").draw_with_depth(Rng.of(seed), 3, (8, 8), scene(8, 8))[0]
    assert 175 <= green <= 230
    assert abs(red - green) <= 6.001
    assert red - green == pytest.approx(green - blue, abs=1e-3)


def test_at_the_visibility_two_percent_of_the_contrast_are_left():
    black, white = np.zeros((1, 5, 3), np.uint8), np.full((1, 5, 3), 255, np.uint8)
    metres, known = np.array([VISIBILITIES], np.float32), np.ones((1, 5), bool)
    depth = SceneDepth((metres, metres), (known, known), Camera((5.0, 5.0), (2.0, 0.0)))
    for severity in range(1, 6):
        dark, bright = (corrupt(one, one, "fog_3d", severity, depth=depth)[0].astype(int) for one in (black, white))
        assert np.abs((bright - dark)[0, severity - 1] - 0.02 * 255).max() < 1.01  # both are rounded


def test_each_frame_is_fogged_by_its_own_depth():
    near, far, known = (np.full((16, 16), value, kind) for value, kind in ((1, "f4"), (900, "f4"), (True, bool)))
    frame, camera = picture(16, 16), Camera((16.0, 16.0), (8.0, 8.0))
    first, second = corrupt(frame, frame, "fog_3d", 5, depth=SceneDepth((near, far), (known, known), camera))
    assert np.abs(first.astype(int) - frame).max() < 20
    assert len(np.unique(second.reshape(-1, 3), axis=0)) == 1


def test_without_depth_it_is_refused_and_says_where_depth_comes_from():
    frame = picture(16, 16)
    with pytest.raises(UsageError, match=r"fog_3d requires the depth of the sample: .* --depth DIR"):
        corrupt(frame, frame, "fog_3d", 3)


def test_far_layers_of_shapes_lose_more_contrast_than_near_ones():
    data = load_dataset("shapes", pairs=1, size="96x128")
    sample = data.load("000000")
    depth = data.depth(sample)
    first = corrupt(*sample.frames, "fog_3d", 4, depth=depth)[0]
    near = depth.maps[0] < 20
    assert first[~near].std(axis=0).max() < 0.2 * sample.frames[0][~near].std(axis=0).max()
    assert first[near].std(axis=0).min() > 0.5 * sample.frames[0][near].std(axis=0).min()


@pytest.mark.parametrize("name", ["fog_3d", "snow_3d", "near_focus", "motion_blur_3d"])
def test_depth_maps_of_a_different_size_than_the_frames_are_refused(name):
    frame, metres, known = np.zeros((40, 60, 3), np.uint8), np.ones((20, 30), np.float32), np.ones((20, 30), bool)
    depth = SceneDepth((metres, metres), (known, known), Camera((30.0, 30.0), (15.0, 10.0)))
    with pytest.raises(DataError, match="the depth maps are 30x20, but the frames are 60x40"):
        corrupt(frame, frame, name, 3, depth=depth)


@pytest.mark.parametrize(
    ("first", "second", "mask", "message"),
    [
        (np.ones((4, 6)), np.ones((4, 6), np.float32), np.ones((4, 6), bool), "depth map 1: expected float32"),
        (
            np.ones((4, 6), np.float32),
            np.ones((4, 5), np.float32),
            np.ones((4, 6), bool),
            "depth map 2: expected float32",
        ),
        (
            np.ones((4, 6), np.float32),
            np.ones((4, 6), np.float32),
            np.ones((4, 6)),
            "mask of depth map 1: expected bool",
        ),
        (np.ones((4, 6), np.float32), np.zeros((4, 6), np.float32), np.ones((4, 6), bool), "depth map 2: every pixel"),
        (np.full((4, 6), np.nan, np.float32), np.ones((4, 6), np.float32), np.ones((4, 6), bool), "1: every pixel"),
    ],
)
def test_depth_that_cannot_be_is_refused(first, second, mask, message):
    with pytest.raises(DataError, match=message):
        SceneDepth((first, second), (mask, mask), Camera((5.0, 5.0), (2.0, 0.0)))
