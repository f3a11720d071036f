"""Compare 3D fog with Koschmieder's law in float64."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError, UsageError
from robustflow.core.rng import Rng
from robustflow.core.types import Camera, SceneDepth
from robustflow.corruptions import corrupt, load_corruption

from .pictures import picture, ray_lengths, scene, seen

VISIBILITIES = (1000.0, 500.0, 250.0, 125.0, 60.0)
"""Distances in metres at which 2 % of the contrast are left; exp(-3.912) is 0.02."""


@settings(max_examples=60)
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
    lenses = (30.0, 20.0, 15.0, 10.0), (45.0, 40.0, 8.0, 17.0)
    depth = SceneDepth(maps, (known, known), Camera(lenses[0][:2], lenses[0][2:], second=lenses[1]))
    frames = picture(20, 30), picture(20, 30, seed=1)
    corruption = load_corruption("fog_3d")
    state = corruption.draw_with_depth(Rng.of(seed), severity, (20, 30), depth)
    airlight = state[0].astype(np.float64)
    for index, frame in enumerate(frames):
        distance = maps[index].astype(np.float64) * ray_lengths(lenses[index], (20, 30))
        passed = np.exp(-3.912 / VISIBILITIES[severity - 1] * distance)[..., None]
        expected = passed * frame + (1 - passed) * airlight
        assert np.abs(corruption.apply(frame, state, index) - expected).max() < 0.51


@settings(max_examples=100)
@given(seed=st.integers(0, 2**64 - 1))
def test_the_airlight_is_a_bright_near_grey(seed):
    red, green, blue = load_corruption("fog_3d").draw_with_depth(Rng.of(seed), 3, (8, 8), scene(8, 8))[0]
    assert 175 <= green <= 230
    assert abs(red - green) <= 6.001
    assert red - green == pytest.approx(green - blue, abs=1e-3)


def test_fog_without_depth_is_refused_with_the_sources_of_depth():
    frame = picture(16, 16)
    with pytest.raises(UsageError, match=r"fog_3d requires the depth of the sample: .* --depth DIR"):
        corrupt(frame, frame, "fog_3d", 3)


@pytest.mark.parametrize("name", ["fog_3d", "snow_3d", "near_focus", "motion_blur_3d"])
def test_depth_maps_of_a_different_size_than_the_frames_are_refused(name):
    frame, metres, known = np.zeros((40, 60, 3), np.uint8), np.ones((20, 30), np.float32), np.ones((20, 30), bool)
    depth = SceneDepth((metres, metres), (known, known), Camera((30.0, 30.0), (15.0, 10.0)))
    with pytest.raises(DataError, match="the depth maps are 20x30, but the frames are 40x60"):
        corrupt(frame, frame, name, 3, depth=depth)


@pytest.mark.parametrize("depth", [np.ones((8, 9), np.float32), np.ones((8, 9)), 5.0, "maps"])
def test_depth_that_is_no_scene_depth_object_is_refused_in_one_sentence(depth):
    frame = picture(8, 9)
    with pytest.raises(UsageError, match=r"fog_3d: depth is \w+; pass a robustflow\.SceneDepth"):
        corrupt(frame, frame, "fog_3d", 3, depth=depth)


BLURS = ("near_focus", "far_focus", "motion_blur_3d")
DEPTH_CORRUPTIONS = ("fog_3d", "rain_3d", "snow_3d", *BLURS)


@pytest.mark.parametrize("name", BLURS)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**16), value=st.integers(0, 255), severity=st.integers(1, 5))
def test_uniform_frame_stays_uniform_under_blurs_at_any_depth(name, seed, value, severity):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 60, (9, 13)).astype(np.float32).repeat(7, axis=0).repeat(9, axis=1)
    depth += rng.uniform(0, 1, depth.shape).astype(np.float32)
    turned = cv2.Rodrigues(rng.uniform(-0.02, 0.02, 3))[0]
    frame = np.full((*depth.shape, 3), value, np.uint8)
    moving = seen(depth, rotation=turned, translation=rng.uniform(-2, 2, 3))
    assert np.array_equal(corrupt(frame, frame, name, severity, depth=moving), [frame, frame])


@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (90, 1), (7, 2000), (2000, 7)])
@pytest.mark.parametrize("name", DEPTH_CORRUPTIONS)
def test_frames_of_any_shape_are_corrupted_at_the_lowest_and_highest_severity(name, shape):
    frame, metres = picture(*shape), np.random.default_rng(1).uniform(1, 80, shape).astype(np.float32)
    known, longer = np.ones(shape, bool), float(max(shape))
    camera = Camera((longer, longer), (shape[1] / 2, shape[0] / 2), np.eye(3), np.array([0.3, 0.1, -1.0]))
    for severity in (1, 5):
        pair = corrupt(frame, frame, name, severity, depth=SceneDepth((metres, metres), (known, known), camera))
        assert [(each.shape, each.dtype) for each in pair] == [(frame.shape, np.uint8)] * 2


@pytest.mark.parametrize("name", DEPTH_CORRUPTIONS)
@pytest.mark.parametrize("metres", [1e-45, 1e-38, 3e38])
def test_depths_at_the_limits_of_float32_give_an_even_frame_an_even_colour(name, metres):
    frame, known = np.full((20, 30, 3), 200, np.uint8), np.ones((20, 30), bool)
    depth = np.full((20, 30), metres, np.float32)
    depth[5:9, 7:20] = 2.0
    for moved in (np.zeros(3), np.array([0.3, 0.1, -1.0]), np.full(3, 1e6)):
        camera = Camera((30.0, 30.0), (14.5, 9.5), np.eye(3), moved)
        for out in corrupt(frame, frame, name, 3, depth=SceneDepth((depth, depth), (known, known), camera)):
            if name in BLURS:
                assert (out == 200).all()
