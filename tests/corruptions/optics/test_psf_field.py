"""The PSFs of a lens (energy, symmetry, centring), and the nodes and transforms of the blur."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.corruptions.optics.blur import LENGTHS, twiddles
from robustflow.corruptions.optics.design import shipped_lens
from robustflow.corruptions.optics.psf_field import (
    PITCHES,
    Axis,
    PsfField,
    half_digest,
    halved,
    manifest,
    shipped_field,
)
from robustflow.corruptions.optics.render import render_psfs

from ...refusals import refusal

SEVERITIES = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_shipped_psfs_are_normalised_symmetric_and_centred(severity):
    field = shipped_field(severity)
    assert field.stack.shape == (64, 3, 61, 61)
    assert field.stack.dtype == np.float32
    assert field.stack.min() >= 0.0
    assert field.stack.astype(float).sum((2, 3)) == pytest.approx(1.0, abs=1e-6)
    assert (field.stack == field.stack[..., ::-1]).all()
    green = field.stack[:, 1].astype(float).sum(2)
    assert np.abs(green @ np.arange(-30, 31)).max() <= 0.05, "the ground truth remains valid"


@pytest.mark.slow
@pytest.mark.parametrize("severity", SEVERITIES)
def test_every_lens_renders_to_the_shipped_bytes(severity):
    assert half_digest(halved(render_psfs(shipped_lens(severity)))) == manifest()[f"psf_s{severity}"]


@pytest.mark.parametrize("shape", [(64, 3, 61, 61), (63, 3, 61, 61), (64, 3, 61)])
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_invalid_psf_stack_is_refused(shape, value):
    refusal(lambda: PsfField(np.full(shape, value)), DataError, "PSF stack")


@pytest.mark.parametrize("length", LENGTHS)
def test_twiddles_are_decided_by_more_than_the_last_bits_of_sine_and_cosine(length):
    """An error of ten units in the last place of a double, larger than in any math library, does not change any
    float32 value.
    """
    for k, pair in enumerate(twiddles(length)):
        angle = 2.0 * math.pi * k / length
        for value, exact in zip(pair, (math.cos(angle), -math.sin(angle)), strict=True):
            slack = 10 * math.ulp(1.0)  # includes the error of the angle
            assert np.float32(exact - slack) == np.float32(exact + slack) == value or abs(exact) < 1e-12, Fraction(
                k, length
            )


@settings(max_examples=100)
@given(st.integers(1, 5000), st.sampled_from(PITCHES))
def test_windows_of_all_nodes_and_their_mirror_images_add_up_to_one(length, pitch):
    axis = Axis.of(length, pitch)
    reach = 400
    total = np.zeros(length + 2 * reach)
    for start, window in zip(axis.starts, axis.windows, strict=True):
        total[start + reach : start + reach + window.size] += window
    total += total[::-1]
    assert total[reach : reach + length] == pytest.approx(1.0, abs=1e-12)
