"""Compare 3D fog and 3D defocus with Koschmieder's law and a thin lens in float64, at any depth and size."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.rng import Rng
from robustflow.core.types import Camera, SceneDepth
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.depth.defocus_3d import FarFocus, NearFocus, ThinLens
from robustflow.corruptions.kernels.disk import convolve_disk

from .pictures import picture, ray_lengths, seen

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


both = pytest.mark.parametrize("kind", [NearFocus, FarFocus])
NEAR, FAR = 2.0, 12.0


def halves(shape):
    """Return the depth of a scene with a near part at `NEAR` and a far part at `FAR`."""
    depth = np.full(shape, NEAR, np.float32)
    depth[:, shape[1] // 2 :] = FAR
    return depth


def drawn(kind, severity, first, second=None):
    return kind().draw_scene(Rng.of("nothing"), severity, seen(first, second))


def differs_by_rounding(out, expected):
    difference = np.abs(out.astype(int) - expected.astype(int))
    return difference.max() <= 1 and (difference > 0).mean() < 1e-3


@both
@settings(max_examples=15)
@given(severity=st.integers(1, 5), size=st.tuples(st.integers(20, 70), st.integers(20, 150)), seed=st.integers(0, 99))
def test_a_plane_at_the_stated_depth_is_the_flat_disk_of_the_severity(kind, severity, size, seed):
    frame, radius = picture(*size, seed=seed), kind.paper_severities[severity - 1]
    out_of_focus = np.full(size, FAR if kind is NearFocus else NEAR, np.float32)
    state = drawn(kind, severity, halves(size), out_of_focus)
    assert differs_by_rounding(kind().apply(frame, state, 1), convolve_disk(frame, radius, 0.0))


@given(distance=st.floats(0.6, 500), focus=st.floats(1, 50), stop=st.floats(1.4, 8))
def test_the_radius_is_that_of_a_thin_lens(distance, focus, stop):
    length, pitch = 0.008, 4.65e-6  # metres
    disk = length**2 / stop * abs(distance - focus) / (distance * (focus - length)) / pitch
    frame, depth = picture(30, 40), np.full((30, 40), distance, np.float32)
    state = drawn(NearFocus, 1, depth)._replace(
        lens=ThinLens(focus, length**2 / stop / (focus - length) / pitch / 2, 25.0)
    )
    expected = min(disk / 2, 25.0)
    # a disk includes the pixels whose centres it covers; if one is very close to the edge, either result is correct
    sides = [convolve_disk(frame, expected * factor, 0.0) for factor in (1 - 1e-5, 1 + 1e-5)]
    assert any(differs_by_rounding(NearFocus().apply(frame, state, 0), side) for side in sides)


def before_a_wall():
    """Return a block at `NEAR` in front of a wall at `FAR`, as (depth, mask)."""
    mask = np.zeros((60, 80), bool)
    mask[20:40, 25:55] = True
    return np.where(mask, NEAR, FAR).astype(np.float32), mask


def test_a_sharp_foreground_does_not_bleed_into_the_blurred_background():
    depth, block = before_a_wall()
    frame = picture(60, 80)
    frame[..., 0] = np.where(block, 255, 0)
    out = NearFocus().apply(frame, drawn(NearFocus, 4, depth), 0)
    assert (out[~block, 0] == 0).all()
    assert np.array_equal(out[block], frame[block])
    assert (out[~block] != frame[~block]).any(axis=1).mean() > 0.9


@pytest.mark.parametrize("severity", [1, 3, 5])
def test_a_blurred_foreground_spreads_over_the_sharp_background_in_proportion(severity):
    depth, block = before_a_wall()
    frame = np.where(block, 255, 30).astype(np.uint8)[..., None].repeat(3, axis=2)
    expected = convolve_disk(frame, FarFocus.paper_severities[severity - 1], 0.0)
    assert (expected[~block] > 30).any()
    assert (expected[block] < 255).any()
    out = FarFocus().apply(frame, drawn(FarFocus, severity, depth), 0)
    assert np.abs(out.astype(int) - expected.astype(int)).max() <= 1


@both
def test_a_scene_at_one_depth_is_in_focus(kind):
    frame = picture(40, 50)
    assert np.array_equal(kind().apply(frame, drawn(kind, 5, np.full((40, 50), 4.0, np.float32)), 0), frame)
