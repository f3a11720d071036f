"""Colour jitter returns the same bytes as torchvision, which the original code uses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from robustflow.core.rng import Rng
from robustflow.training.augmentation.jitter import DENSE, OPERATIONS, SPARSE, Jitter, apply_jitter, draw_jitter

pytestmark = pytest.mark.training

_factors = st.floats(0.5, 1.5)


def by_torchvision(image: np.ndarray, jitter: Jitter) -> np.ndarray:
    """Apply the operations in the order of the jitter; torchvision draws parameters and order itself."""
    torchvision = pytest.importorskip("torchvision.transforms.functional", reason="needs the torch extra")
    picture = Image.fromarray(image)
    for operation in jitter.order:
        picture = getattr(torchvision, f"adjust_{operation}")(picture, getattr(jitter, operation))
    return np.asarray(picture)


@settings(max_examples=60, deadline=None)
@given(
    brightness=_factors,
    contrast=_factors,
    saturation=_factors,
    hue=st.floats(-0.5, 0.5),
    order=st.permutations(OPERATIONS),
    seed=st.integers(0, 2**31),
    spread=st.sampled_from([256, 40, 3]),
)
def test_jitter_is_byte_identical_to_torchvision(brightness, contrast, saturation, hue, order, seed, spread):
    image = (np.random.default_rng(seed).integers(0, spread, (23, 31, 3)) + (256 - spread) // 2).astype(np.uint8)
    jitter = Jitter(brightness, contrast, saturation, hue, tuple(order))
    before = image.copy()
    np.testing.assert_array_equal(apply_jitter(image, jitter), by_torchvision(image, jitter))
    np.testing.assert_array_equal(image, before)


def test_hue_shift_of_every_colour_equals_torchvision():
    steps = np.arange(0, 256, 5, dtype=np.uint8)
    image = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(len(steps), -1, 3)
    for turn in range(-127, 128, 14):
        jitter = Jitter(1, 1, 1, turn / 255 + np.copysign(1e-6, turn), ("hue",))
        np.testing.assert_array_equal(apply_jitter(image, jitter), by_torchvision(image, jitter))


@pytest.mark.parametrize("strength", [DENSE, SPARSE])
def test_jitter_draws_its_stated_ranges(strength):
    drawn = [draw_jitter(Rng.of("test", number), strength) for number in range(3000)]
    for name in OPERATIONS:
        values, middle, most = [getattr(one, name) for one in drawn], float(name != "hue"), getattr(strength, name)
        assert min(values) >= middle - most
        assert max(values) <= middle + most
        counts = np.histogram(values, bins=10, range=(middle - most, middle + most))[0]
        assert np.square(counts - 300).sum() / 300 < 33.7  # chi-square, 9 degrees of freedom, p = 1e-4
    orders, counts = np.unique(["".join(one.order) for one in drawn], return_counts=True)
    assert len(orders) == 24
    assert np.square(counts - 125).sum() / 125 < 58.6  # 23 degrees of freedom, p = 5e-5
