"""Compare 3D motion blur with points and planes projected in float64."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robustflow.core.rng import Rng
from robustflow.core.types import SceneDepth
from robustflow.corruptions.depth.motion_blur_3d import MotionBlur3d

from .pictures import picture, plane, seen

SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
severities = st.integers(1, 5)


def blurred(frame, depth, severity, index=0, seed=0):
    state = MotionBlur3d().draw_scene(Rng.of(seed), severity, depth)
    return MotionBlur3d().apply(frame, state, index)


def moving(first, second=None, by=(0.0, 0.0, 0.0), rotation=None):
    """Return the depth of a plane whose points move by `by` metres in camera coordinates between the frames."""
    rotation = np.eye(3) if rotation is None else rotation
    return seen(first, second, rotation=rotation, translation=np.array(by))


def level(shape, depth):
    return np.full(shape, depth, np.float32)


@settings(max_examples=20)
@given(seed=st.integers(0, 99), severity=severities, index=st.integers(0, 1))
def test_without_motion_a_frame_is_unchanged(seed, severity, index):
    frame = picture(40, 60, seed=seed)
    depth = np.random.default_rng(seed).uniform(0.5, 80, (2, 40, 60)).astype(np.float32)
    assert np.array_equal(blurred(frame, moving(*depth), severity, index), frame)


@settings(max_examples=20)
@given(severity=severities, shift=st.floats(-3, 3), metres=st.floats(8, 40), vertical=st.booleans())
def test_a_plane_that_moves_up_or_a_little_is_the_mean_of_shifted_frames(severity, shift, metres, vertical):
    frame = picture(45, 70)
    path = 100 * shift / np.float32(metres) * SHARES[severity - 1]
    count = 1 + int(np.ceil(abs(path)))
    vertical = vertical or count > 6
    out = blurred(frame, moving(level((45, 70), metres), by=(0, shift, 0) if vertical else (shift, 0, 0)), severity)
    steps = 8 if count <= 6 else 1  # per pixel; a position halfway between two steps may be rounded either way
    ways = path * ((np.arange(count) + 0.5) / count - 0.5)
    axis, size = (0, 45) if vertical else (1, 70)
    total = np.zeros(frame.shape)
    for way in np.floor(-ways * steps + 0.5) / steps:
        at = np.clip(np.arange(size) + way, 0, size - 1)
        left = np.floor(at).astype(int)
        part = (at - left).reshape((-1, 1, 1) if vertical else (1, -1, 1))
        right = np.minimum(left + 1, size - 1)
        total += (1 - part) * frame.take(left, axis) + part * frame.take(right, axis)
    if (abs(ways * steps % 1 - 0.5) > 2e-3).all() and abs(abs(path) - np.rint(abs(path))) > 1e-3:
        assert np.abs(out - total / count).max() <= 0.5 + 1e-9


@settings(max_examples=30)
@given(path=st.floats(5.1, 480), sign=st.sampled_from([-1, 1]), index=st.integers(0, 1))
def test_a_plane_that_moves_far_sideways_is_the_integral_along_its_path(path, sign, index):
    """Each pixel is weighted by the length of the path inside it; path ends are on a grid of 1/64 px (1/8 px for
    paths longer than 60 px).
    """
    frame = picture(9, 90)
    depth = moving(level(frame.shape[:2], 10.0), by=(sign * path / 10, 0, 0))
    wide = np.pad(frame, ((0, 0), (300, 300), (0, 0)), mode="edge").astype(np.float64)
    edges, columns = np.arange(691) - 300.0, np.arange(90)[:, None] + 0.5
    low, high = columns - path / 2, columns + path / 2
    lengths = np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0, None)
    expected = np.einsum("xk,ykc->yxc", lengths, wide) / path
    grid = 1 / 64 if path < 60 else 1 / 8
    assert np.abs(blurred(frame, depth, 5, index) - expected).max() <= 0.51 + 2 * 255 * grid / path


@settings(max_examples=25)
@given(
    at=st.tuples(st.integers(25, 74), st.integers(20, 39)),
    by=st.tuples(st.floats(-0.8, 0.8), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5)),
    angle=st.floats(-0.05, 0.05),
    severity=severities,
)
def test_a_dot_is_smeared_along_its_projections(at, by, angle, severity):
    metres, share = 6.0, SHARES[severity - 1]
    frame = np.zeros((60, 100, 3), np.uint8)
    # three pixels wide: a single pixel may fall between the pixels of a view that shrinks it
    frame[at[1] - 1 : at[1] + 2, at[0] - 1 : at[0] + 2] = 255
    rotation = Rotation.from_euler("y", angle).as_matrix()
    ys, xs = np.nonzero(blurred(frame, moving(level((60, 100), metres), by=by, rotation=rotation), severity)[..., 0])
    point = np.array([(at[0] - 49.5) / 100, (at[1] - 29.5) / 100, 1]) * metres
    step = rotation @ point + by - point
    times = np.linspace(-share / 2, share / 2, 201)[:, None]
    way = point + times * step
    way = way[:, :2] / way[:, 2:] * 100 + [49.5, 29.5]
    smeared = np.stack([xs, ys], axis=1)
    distances = np.hypot(*(smeared[:, None] - way[None]).transpose(2, 0, 1))
    assert distances.min(axis=1).max() < 1.6 + 2**0.5, "a pixel outside the path"
    assert distances.min(axis=0).max() < 1, "a part of the path without a pixel"


@pytest.mark.parametrize(("far", "by"), [(16.0, 1.2), (7.0, 0.6)])
def test_many_edges_are_close_to_the_mean_of_many_views_in_float64(far, by):
    """Compare blocks that move sideways at three depths with the mean of 401 views of the nearest surface.

    Only pixels whose views all show content of the frame are compared, because the others have no reference value.
    """
    rng = np.random.default_rng(3)
    metres = rng.choice([4.0, 6.0, far], (4, 14)).astype(np.float32).repeat(8, axis=0).repeat(11, axis=1)
    frame = picture(32, 154)
    total, known = np.zeros(frame.shape), np.ones(metres.shape, bool)
    for time in np.linspace(-0.5, 0.5, 401):
        view, seen = np.zeros(frame.shape), np.zeros(metres.shape, bool)
        for each in (far, 6.0, 4.0):
            origin = np.floor(np.arange(154) + 0.5 - time * by * 100 / each).astype(int)
            shows = (metres[:, np.clip(origin, 0, 153)] == each) & (origin >= 0) & (origin < 154)
            view[shows] = frame[:, np.clip(origin, 0, 153)][shows]
            seen |= shows
        total += view
        known &= seen
    assert known.mean() > 0.2
    difference = np.abs(blurred(frame, moving(metres, by=(by, 0, 0)), 5) - total / 401)[known]
    assert np.mean(difference) < 1.66
    assert np.quantile(difference, 0.9) < 4.5


def test_a_camera_of_unknown_motion_makes_a_drawn_one():
    depth = plane(7.0, (60, 100))
    paths = [MotionBlur3d().draw_scene(Rng.of(seed), 5, depth).path for seed in range(40)]
    assert all(np.array_equal(path.rotation, np.eye(3)) for path in paths)
    # 3 % of the width (100 px) at 7 m with a focal length of 100 px is 0.21 m; for forward motion, 4 * 0.03 * 7 m
    assert np.allclose([np.sum((path.translation / (0.21, 0.21, 0.84)) ** 2) for path in paths], 1)
    assert len({path.translation.tobytes() for path in paths}) == 40
    frame = picture(60, 100)
    assert (blurred(frame, depth, 5) != frame).any()


def test_each_frame_is_blurred_through_its_own_lens():
    depth = moving(level((60, 100), 4.0), by=(0, 0, -1.0))
    zoomed = SceneDepth(depth.maps, depth.measured, replace(depth.camera, second=(100.0, 100.0, 20.0, 30.0)))
    frame = np.zeros((60, 100, 3), np.uint8)
    frame[30, 20], frame[30, 80] = 255, 255
    lit = [blurred(frame, zoomed, 5, index)[30, :, 0] for index in (0, 1)]
    assert 10 < lit[0][:40].max() < 80  # next to the centre of frame 1
    assert lit[1][20] > 200  # at the centre of frame 2
