"""Test 3D rain and snow: the positions of the particles, and which particles and surfaces hide each other."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robustflow.core.rng import Rng
from robustflow.core.types import Camera
from robustflow.corruptions.depth.precipitation import (
    EXPOSURE,
    FRAME_INTERVAL,
    NEAREST,
    Particles,
    Rain3d,
    Snow3d,
    streaks_of,
)
from robustflow.corruptions.depth.scene import STILL

from .pictures import picture, plane, ray_lengths, scene, seen

both = pytest.mark.parametrize("kind", [Rain3d, Snow3d])


def projected(points, camera, index=0):
    fx, fy, cx, cy = camera.intrinsics(index)
    return points[:, :2] / points[:, 2:] * (fx, fy) + (cx, cy)


small = st.floats(-0.2, 0.2)


@both
@settings(max_examples=10)
@given(
    angles=st.tuples(small, small, small),
    shift=st.tuples(small, small, st.floats(-1.5, 0.5)),
    seed=st.integers(0),
    second=st.sampled_from([None, (230.0, 220.0, 185.5, 80.0)]),
)
def test_particle_moves_with_its_speed_and_the_camera(kind, angles, shift, seed, second):
    rotation, translation = Rotation.from_euler("xyz", angles).as_matrix(), np.array(shift)
    depth = plane(30.0, (180, 320), rotation=rotation, translation=translation, focal=200.0)
    depth = replace(depth, camera=replace(depth.camera, second=second))
    particles = kind().draw_scene(Rng.of(seed), 5, depth).particles
    first, speed = particles.positions[0], particles.velocities[0]
    assert len(first) > 20
    at = first, (first + FRAME_INTERVAL * speed) @ rotation.T + translation
    speeds = speed, speed @ rotation.T
    for index in (0, 1):
        # the exposure uses the camera motion between the frames, so points continue to move in the same way
        step = (at[index] + FRAME_INTERVAL * speeds[index]) @ rotation.T + translation - at[index]
        ends = [at[index] + sign * EXPOSURE / 2 / FRAME_INTERVAL * step for sign in (-1, 1)]
        shown = (at[index][:, 2] >= NEAREST) & (np.minimum(ends[0][:, 2], ends[1][:, 2]) >= NEAREST / 2)
        streaks = streaks_of(particles, index)
        assert len(streaks) == shown.sum()
        for columns, end in zip((slice(0, 2), slice(2, 4)), ends, strict=True):
            assert np.abs(streaks[:, columns] - projected(end[shown], depth.camera, index)).max() < 0.01


@both
@pytest.mark.parametrize(("ahead", "zoom"), [(0.0, 1.0), (-1.5, 1.0), (-1.5, 1.6)])
def test_both_frames_see_as_many_particles_as_the_distribution_of_sizes_says(kind, ahead, zoom):
    depth, smallest = (
        plane(30.0, (375, 1242), rotation=np.eye(3), translation=np.array([0.1, 0.0, ahead]), focal=721.0),
        6e-4 * 1242,
    )
    camera = replace(depth.camera, second=(721.0 * zoom, 721.0 * zoom, *depth.camera.centre))
    depth = replace(depth, camera=camera)
    sizes = kind().sizes(kind.paper_severities[4])
    particles = kind().draw_scene(Rng.of("count"), 5, depth).particles
    for index in (0, 1):
        at = particles.positions[index]
        pixel = projected(at, camera, index)
        inside = ((pixel >= -0.5) & (pixel < [1241.5, 374.5])).all(axis=1) & (at[:, 2] >= NEAREST)
        diameters = np.linspace(0, sizes.largest, 20001)
        for low, high in ((0.0, 0.5), (0.5, 1.0)):  # relative to the maximum diameter
            chosen = (diameters > low * sizes.largest) & (diameters <= high * sizes.largest)
            reach = np.maximum(721.0 * diameters[chosen] * 1e-3 / smallest, NEAREST)
            volume = (reach**3 - NEAREST**3) / 3 * 1242 * 375 / camera.intrinsics(index)[0] ** 2
            number = sizes.density * np.exp(-sizes.slope * diameters[chosen])
            expected = (number * volume).sum() * diameters[1]
            size = particles.diameters * 1e3
            visible = inside & (at[:, 2] < 721.0 * particles.diameters / smallest)
            count = (visible & (size > low * sizes.largest) & (size <= high * sizes.largest)).sum()
            assert abs(count - expected) < 4 * math.sqrt(expected)


@both
@pytest.mark.parametrize("index", [0, 1])
def test_the_veil_is_that_of_the_rays_length_beyond_its_start(kind, index):
    lenses, frame = ((70.0, 60.0, 20.0, 50.0), (90.0, 90.0, 80.0, 60.0)), picture(120, 160)
    depth = replace(scene(120, 160), camera=Camera(lenses[0][:2], lenses[0][2:], second=lenses[1]))
    state = kind().draw_scene(Rng.of("veil"), 5, depth)
    out = kind().apply(frame, state._replace(particles=by_hand(np.empty((0, 3)), [], lenses=lenses)), index)
    density, start = state.veil
    beyond = np.maximum(depth.maps[index].astype(np.float64) - start, 0) * ray_lengths(lenses[index], (120, 160))
    passed = np.exp(-density * beyond)[..., None]
    assert passed.min() < 0.9
    assert np.abs(out - (passed * frame + (1 - passed) * np.array(kind.colour))).max() < 0.51


@both
@pytest.mark.parametrize("index", [0, 1])
def test_particles_are_hidden_pixel_by_pixel(kind, index):
    frame, maps = picture(120, 160), np.full((2, 120, 160), 50.0, np.float32)
    maps[:, :, :80] = NEAREST - 0.01
    hidden, open_sky = (
        kind().apply(frame, kind().draw_scene(Rng.of("half"), 5, depth), index)
        for depth in (seen(*maps), plane(50.0, (120, 160)))
    )
    assert np.array_equal(hidden[:, :80], frame[:, :80])
    assert np.array_equal(hidden[:, 80:], open_sky[:, 80:])
    assert (open_sky != frame).any(axis=(0, 2)).all()


def by_hand(points, diameters, speed=(0.0, 0.0, 0.0), lenses=((100.0, 100.0, 79.5, 59.5),) * 2):
    first = np.array(points, np.float64)
    velocity = np.tile(np.array(speed), (len(first), 1))
    return Particles(
        (first, first + FRAME_INTERVAL * velocity), (velocity, velocity), np.array(diameters, np.float64),
        np.array(lenses), STILL,
    )  # fmt: skip


def shares(particles, index=0, depth=None):
    """Return the fraction of each pixel covered by the particles, for 120x160 pixels."""
    depth = depth or plane(50.0, (120, 160))
    state = Snow3d().draw_scene(Rng.of("hand"), 1, depth)._replace(particles=particles, veil=(0.0, 1.0))
    white = type("White", (Snow3d,), {"colour": (255.0, 255.0, 255.0)})()
    return white.apply(np.zeros((120, 160, 3), np.uint8), state, index)[..., 0] / 255


@pytest.mark.parametrize("radius", [0.3, 0.8, 2.0, 6.0])
@pytest.mark.parametrize("streak", [0.0, 4.0])
def test_particle_covers_its_area_at_any_size_and_speed(radius, streak):
    rng = np.random.default_rng(3)
    depth, total, count = 5.0, 0.0, 40
    for _ in range(count):
        x, y = (rng.uniform(-20, 20, 2) / 100) * depth
        angle = rng.uniform(0, 2 * np.pi)
        speed = streak / 100 * depth / EXPOSURE * np.array([np.cos(angle), np.sin(angle), 0])
        total += shares(by_hand([(x, y, depth)], [2 * radius * depth / 100], speed=speed)).sum()
    tolerance = 0.1 if radius < 0.5 else 0.02  # the effect of faint particles is rounded to integers
    assert total / count == pytest.approx(np.pi * radius**2, rel=tolerance)


@both
def test_camera_of_unknown_motion_is_at_rest(kind):
    frame = picture(60, 90)
    still = plane(20.0, (60, 90), rotation=np.eye(3), translation=np.zeros(3))
    unknown = plane(20.0, (60, 90))
    for index in (0, 1):
        a, b = (kind().apply(frame, kind().draw_scene(Rng.of("p"), 3, one), index) for one in (still, unknown))
        assert np.array_equal(a, b)
