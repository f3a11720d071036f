"""Test strips and tiles of an image."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.corruptions.optics.blur import BLOCK, LENGTHS, transform, twiddles
from robustflow.corruptions.optics.psf_field import PITCHES, Axis, grid_of, kernels_at

from .naive_blur import kernel_at


@pytest.mark.parametrize("length", [2, 3, 4, 6, 24, 72, 81, 96, 108, 128])
def test_transform_of_noise_equals_numpys(length):
    work = np.random.default_rng(length).normal(size=(2, 1, length, 2, BLOCK)).astype(np.float32)
    wanted = np.fft.fft(work[..., 0, :].astype(float) + 1j * work[..., 1, :], axis=2)
    transform(work, twiddles(length))
    assert np.abs(work[..., 0, :] + 1j * work[..., 1, :] - wanted).max() < 1e-6 * np.abs(wanted).max()


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


@settings(max_examples=100)
@given(st.integers(1, 5000), st.sampled_from(PITCHES))
def test_windows_contain_their_complete_triangle(length, pitch):
    axis = Axis.of(length, pitch)
    assert axis.pitch <= pitch
    assert axis.windows.shape[1] == 2 * pitch
    # the triangular windows are complete: they are zero one pixel further out
    places = (length - 1) / 2 + axis.offsets
    last = np.array(axis.starts) + axis.windows.shape[1]
    assert (last - places >= axis.pitch - 1e-9).all()
    assert (np.array(axis.starts) - 1 - places <= -axis.pitch + 1e-9).all()


def test_nodes_lie_closer_in_small_images():
    pitches = [grid_of(side, side) for side in (16, 300, 700, 1000, 1200, 2000, 5000)]
    assert pitches == sorted(pitches)
    assert pitches[0] == 12
    assert pitches[-1] == 34


def test_kernels_are_those_of_the_definition():
    rng = np.random.default_rng(5)
    stack = rng.random((64, 3, 61, 61)).astype(np.float32)
    height, width = 201, 333
    points = [(0.0, 0.0), (166.0, 100.0), (331.5, 12.25), (40.0, 199.0), (332.0, 200.0)]
    dx = np.array([x - (width - 1) / 2 for x, _ in points])
    dy = np.array([y - (height - 1) / 2 for _, y in points])
    out = np.empty((len(points), 3, 61, 61))
    kernels_at(stack, dx, dy, np.hypot(height, width) / 2, out)
    for ours, (x, y) in zip(out, points, strict=True):
        assert ours == pytest.approx(kernel_at(stack, x, y, height, width), abs=1e-9)


def test_points_beyond_the_corner_take_the_corners_kernel():
    stack = np.random.default_rng(0).random((64, 3, 61, 61)).astype(np.float32)
    out = np.empty((2, 3, 61, 61))
    kernels_at(stack, np.array([0.0, 0.0]), np.array([50.0, 80.0]), 50.0, out)
    assert (out[0] == out[1]).all()
