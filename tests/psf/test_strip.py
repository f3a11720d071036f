"""The arithmetic of the blur: transforms against NumPy's, and why the bits are the same everywhere."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from robustflow.psf.strip import BLOCK, LENGTHS, transform, twiddles


@pytest.mark.parametrize("length", [2, 3, 4, 6, 24, 72, 81, 96, 108, 128])
def test_transform_of_noise_equals_numpys(length):
    work = np.random.default_rng(length).normal(size=(2, 1, length, 2, BLOCK)).astype(np.float32)
    wanted = np.fft.fft(work[..., 0, :].astype(float) + 1j * work[..., 1, :], axis=2)
    transform(work, twiddles(length))
    assert np.abs(work[..., 0, :] + 1j * work[..., 1, :] - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_transform_with_parts_exchanged_is_the_inverse():
    before = np.random.default_rng(0).normal(size=(1, 2, 36, 2, BLOCK)).astype(np.float32)
    work = before.copy()
    transform(work, twiddles(36))
    work = np.ascontiguousarray(work[..., ::-1, :])
    transform(work, twiddles(36))
    assert work[..., ::-1, :] / 36 == pytest.approx(before, abs=2e-6)


@pytest.mark.parametrize("length", LENGTHS)
def test_twiddles_are_decided_by_more_than_the_last_bits_of_sine_and_cosine(length):
    """Ten units in the last place of a double, more than any mathematics library errs by, change no float."""
    for k, pair in enumerate(twiddles(length)):
        angle = 2.0 * math.pi * k / length
        for value, exact in zip(pair, (math.cos(angle), -math.sin(angle)), strict=True):
            slack = 10 * math.ulp(1.0)  # the error of the angle counts too
            assert np.float32(exact - slack) == np.float32(exact + slack) == value or abs(exact) < 1e-12, Fraction(
                k, length
            )
