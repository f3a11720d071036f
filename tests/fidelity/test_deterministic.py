"""Compare every image pixel by pixel, for corruptions without randomness except in the choice of the frame."""

import numpy as np
import pytest

from robustflow.random.rng import Rng

from . import reference

pytestmark = pytest.mark.fidelity

EXACT = ("jpeg_compression", "pixelate")
"""Corruptions that must match exactly; others may differ by one grey level, the rounding error of the reference."""


@pytest.mark.parametrize(("name", "key"), reference.cases("deterministic"))
def test_pictures(name, key, record_property):
    level, _, exposed = key.partition("_idx")

    def expose(state):
        return state._replace(exposed=int(exposed)) if exposed else state

    pair = reference.corrupted(reference.ours(name), Rng.of(0), int(level[1:]), expose)
    y, x, height, width = reference.table()["input"]["crop_y0_x0_h_w"]
    for number, frame in enumerate(pair, start=1):
        picture = f"png/{name}_{key}_f{number}.png"
        expected = reference.read_image(picture)
        assert expected is not None, f"{picture} is missing"
        difference = np.abs(frame[y : y + height, x : x + width].astype(int) - expected)
        worst = int(difference.max())
        where = f"grey levels, on {np.count_nonzero(difference) / difference.size:.1%} of {picture}"
        record_property("deviation", ("deterministic", reference.OUR_NAMES.get(name, name), float(worst), where))
        assert worst <= (0 if name in EXACT else 1), f"{worst} {where}"


@pytest.mark.parametrize(("name", "key"), reference.cases("deterministic"))
def test_whole_frames(name, key):
    """The images also agree on average.

    Means and standard deviations differ by at most the effect of changing every pixel by one level.
    """
    level, _, exposed = key.partition("_idx")

    def expose(state):
        return state._replace(exposed=int(exposed)) if exposed else state

    pair = reference.corrupted(reference.ours(name), Rng.of(0), int(level[1:]), expose)
    expected = reference.table()["deterministic"][name][key]
    allowed = 1e-4 if name in EXACT else 1.0
    for number, frame in enumerate(pair, start=1):
        for channel, letter in enumerate("rgb"):
            values = frame[..., channel].astype(np.float64)
            assert values.mean() == pytest.approx(expected[f"mean_{letter}_{number}"], abs=allowed)
            assert values.std() == pytest.approx(expected[f"std_{letter}_{number}"], abs=allowed)
