"""Compare the corner of the plasma map with a full map computed in NumPy, and the blend with its formula."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions.kernels.fields import plasma_corner
from robustflow.corruptions.weather.fog import Fog


def whole_map(rng, size, decay):
    """Run the diamond-square algorithm on a torus of `size` points, in float64 with rolled arrays, without scaling."""
    grid = np.zeros((1, 1))
    level = 0
    while len(grid) < size:
        points = len(grid)
        key = np.uint64(rng.spawn("plasma", level).key)
        bits = np.array([hash64(key, np.uint64(i)) for i in range(points**2)], np.uint64).reshape(points, points)
        amplitude = (100 / decay**level) ** 2
        noise = [amplitude * (((bits >> np.uint64(s)) & np.uint64(0xFFFF)) / 32768 - 1) for s in (0, 16, 32)]
        south, east = np.roll(grid, -1, 0), np.roll(grid, -1, 1)
        centre = (grid + south + east + np.roll(south, -1, 1)) / 4 + noise[0]
        fine = np.empty((2 * points, 2 * points))
        fine[::2, ::2], fine[1::2, 1::2] = grid, centre
        fine[::2, 1::2] = (grid + east + centre + np.roll(centre, 1, 0)) / 4 + noise[1]
        fine[1::2, ::2] = (grid + south + centre + np.roll(centre, 1, 1)) / 4 + noise[2]
        grid, level = fine, level + 1
    return grid


@pytest.mark.parametrize(("shape", "size"), [((16, 16), 16), ((20, 33), 64), ((130, 17), 256)])
def test_corner_of_a_small_fog_map_equals_the_whole_map(shape, size):
    rng = Rng.of("plasma", size)
    expected = whole_map(rng, size, 1.7)
    expected = (expected - expected.min()) / (expected.max() - expected.min())
    assert np.abs(plasma_corner(rng, *shape, 1.7) - expected[: shape[0], : shape[1]]).max() < 1e-5


def test_corner_of_a_large_fog_map_is_scaled_by_its_own_extremes():
    rng = Rng.of("large")
    expected = whole_map(rng, 1024, 1.4)
    low, span = expected.min(), expected.max() - expected.min()
    for height, width in ((40, 1000), (700, 600)):
        got = plasma_corner(rng, height, width, 1.4)
        seen = expected[:height, :width]
        assert np.corrcoef(got.ravel(), seen.ravel())[0, 1] > 0.999999
        assert np.abs(got - (seen - low) / span).max() < 0.002


def test_a_4k_corner_stays_between_0_and_1():
    corner = plasma_corner(Rng.of("4k"), 270, 4096, 2.0)
    assert corner.shape == (270, 4096)
    assert corner.min() >= 0
    assert corner.max() <= 1
    assert np.abs(np.diff(corner, axis=1)).max() < 0.02


@settings(max_examples=25)
@given(st.integers(1, 5), st.integers(0, 255), st.integers(0, 9))
def test_fog_is_blended_by_the_formula(severity, brightest, seed):
    frame = np.random.default_rng(seed).integers(0, brightest + 1, (20, 30, 3)).astype(np.uint8)
    fog = Fog()
    state = fog.draw(Rng.of("blend", seed), severity, (20, 30))
    strength = fog.parameter(severity)[0]
    top = frame.max() / 255
    expected = 255 * (frame / 255 + strength * state[1][..., None].astype(np.float64)) * top / (top + strength)
    assert np.abs(fog.apply(frame, state, 0) - np.clip(expected, 0, 255)).max() < 0.501


def test_the_map_of_a_single_pixel_is_between_0_and_1():
    assert all(0 <= plasma_corner(Rng.of(seed), 1, 1, 2.0).item() <= 1 for seed in range(9))
