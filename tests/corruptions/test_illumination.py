"""Compare illumination corruptions with exact fractions and an HSV round trip; test which frame is exposed."""

from fractions import Fraction

import numpy as np
import pytest
from skimage.color import hsv2rgb, rgb2hsv

from robustflow.core.rng import Rng
from robustflow.corruptions import corrupt, load_corruption

SEVERITIES = (1, 2, 3, 4, 5)
COLOURS = np.random.default_rng(6).integers(0, 256, (64, 97, 3), dtype=np.uint8)
EXPOSURES = ("over_exposure", "under_exposure")


def exposed(name, severity):
    """Return the corruption and a state that corrupts frame 0."""
    corruption = load_corruption(name)
    states = (corruption.draw(Rng.of(seed), severity, (64, 97)) for seed in range(100))
    return corruption, next(state for state in states if not getattr(state, "exposed", 0))


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize(("name", "sign"), [("high_light", 1), ("low_light", -1)])
def test_shift_of_v_equals_the_formula_to_half_a_level(name, sign, severity):
    corruption, state = exposed(name, severity)
    shift = sign * 255 * Fraction(str(corruption.parameter(severity)))
    pixels = np.concatenate([np.zeros((1, 3), np.uint8), COLOURS.reshape(-1, 3)[:3000]])
    for pixel, found in zip(pixels.tolist(), corruption.apply(pixels[None], state, 0)[0].tolist(), strict=True):
        value = max(pixel)
        new = min(max(value + shift, 0), 255)
        assert found == [round(Fraction(channel * new, value) if value else new) for channel in pixel], pixel


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("name", EXPOSURES)
def test_hsv_conversion_survives_a_round_trip(name, severity):
    corruption, state = exposed(name, severity)
    hsv = rgb2hsv(COLOURS)
    hsv[..., 2] = np.minimum(hsv[..., 2] * 2.0 ** corruption.parameter(severity), 1)
    off = corruption.apply(COLOURS, state, 0) - hsv2rgb(hsv) * 255
    assert np.abs(off).max() < 0.5 + 1e-9


@pytest.mark.parametrize("name", EXPOSURES)
def test_exposed_frame_is_drawn_with_equal_probability(name):
    which = []
    for seed in range(200):
        first, second = corrupt(COLOURS, COLOURS, name, 3, seed=seed)
        changed = [not (frame == COLOURS).all() for frame in (first, second)]
        assert sum(changed) == 1
        which.append(changed[1])
    assert 65 < sum(which) < 135
