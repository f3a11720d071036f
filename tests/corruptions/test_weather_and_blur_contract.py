"""What every weather, blur and elastic corruption keeps, at any size."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.corruptions.api import load_corruption
from robustflow.corruptions.weather.frost import photograph
from robustflow.errors import AssetError
from robustflow.random.rng import Rng

NAMES = ["spatter", "fog", "frost", "snow", "gaussian_blur", "defocus_blur", "glass_blur", "camera_motion_blur"]
NAMES += ["elastic_transform"]


def need_textures(name):
    if name == "frost":
        try:
            photograph(0)
        except AssetError as error:
            pytest.skip(f"no frost textures here: {error}")


def random_frame(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=8, deadline=None)
@given(st.integers(16, 90), st.integers(16, 90), st.integers(1, 5), st.sampled_from(["default", "reference", "paper"]))
def test_any_size_same_bytes_from_a_pickled_state_and_an_untouched_frame(name, height, width, severity, variant):
    need_textures(name)
    corruption = load_corruption(name, variant)
    frame = random_frame(height, width)
    kept = frame.copy()
    state = corruption.draw(Rng.of("contract", name), severity, (height, width))
    out = corruption.apply(frame, state, 1)
    assert (out.shape, out.dtype) == (frame.shape, np.uint8)
    assert np.array_equal(frame, kept)
    assert not np.shares_memory(out, frame)
    again = corruption.draw(Rng.of("contract", name), severity, (height, width))
    assert np.array_equal(corruption.apply(frame, pickle.loads(pickle.dumps(again)), 1), out)


@pytest.mark.parametrize("name", NAMES)
def test_views_and_read_only_frames(name):
    need_textures(name)
    corruption = load_corruption(name)
    frame = random_frame(40, 60)
    state = corruption.draw(Rng.of("views"), 2, (40, 60))
    expected = corruption.apply(frame, state, 0)
    reversed_twice = np.ascontiguousarray(frame[:, ::-1])[:, ::-1]
    assert np.array_equal(corruption.apply(reversed_twice, state, 0), expected)
    frame.flags.writeable = False
    assert np.array_equal(corruption.apply(frame, state, 0), expected)


@pytest.mark.parametrize(
    "name", ["spatter", "fog", "frost", "snow", "glass_blur", "camera_motion_blur", "elastic_transform"]
)
def test_other_streams_give_other_pictures(name):
    need_textures(name)
    corruption = load_corruption(name)
    frame = random_frame(64, 64)
    pictures = [corruption.apply(frame, corruption.draw(Rng.of(seed), 5, (64, 64)), 0) for seed in range(3)]
    assert not np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[1], pictures[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_4k(name):
    need_textures(name)
    corruption = load_corruption(name)
    frame = random_frame(2160, 4096)
    out = corruption.apply(frame, corruption.draw(Rng.of("4k"), 5, (2160, 4096)), 0)
    assert out.shape == frame.shape
    assert out.std() > 0
