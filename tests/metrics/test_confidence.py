"""Sparsification, AUSE and the forward-backward check match naive implementations, theoretical values and known
properties.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.stats import spearmanr

from robustflow.metrics import ause, confidence_correlation, error_at, forward_backward

pixels = st.lists(st.tuples(st.integers(0, 20), st.integers(-4, 4)), min_size=1, max_size=40)
"""Errors in multiples of a quarter pixel, and confidences with many ties."""


def naive_curve(errors, keys):
    """Compute the mean over all orderings within a tie, in exact fractions: every pixel of a tie gets the tie's mean
    error.
    """
    mean = {key: [e for e, k in zip(errors, keys, strict=True) if k == key] for key in keys}
    ordered = [Fraction(sum(mean[key]), len(mean[key])) for key in sorted(keys)]
    return [
        sum(ordered[:count], Fraction(0)) / count
        for count in (math.ceil(len(errors) * (100 - k) / 100) for k in range(100))
    ]


def naive_ause(errors, confidence):
    ours = naive_curve(errors, [-c for c in confidence])
    best = naive_curve(errors, errors)
    return float(sum(o - b for o, b in zip(ours, best, strict=True)) / 100)


@given(pixels)
def test_ause_equals_the_definition_in_exact_fractions(case):
    errors, confidence = [Fraction(e, 4) for e, _ in case], [c for _, c in case]
    assert ause([float(e) for e in errors], confidence) == pytest.approx(naive_ause(errors, confidence), abs=1e-12)


@given(pixels)
def test_rank_correlation_equals_scipy(case):
    errors, confidence = zip(*case, strict=True)
    ours = confidence_correlation(errors, confidence)
    if len(set(errors)) == 1 or len(set(confidence)) == 1:
        assert ours is None
    else:
        assert ours == pytest.approx(spearmanr(errors, confidence).statistic, abs=1e-12)


@pytest.mark.slow
def test_rank_correlation_of_sixteen_megapixels_is_that_of_an_image_of_the_same_structure():
    ramps = (np.arange(count) for count in (16_000, 16_000_000))
    small, large = (confidence_correlation(ramp, np.roll(ramp, ramp.size // 4)) for ramp in ramps)
    assert large == pytest.approx(small, abs=1e-3)


def test_error_at_a_coverage_is_that_of_the_most_confident_pixels():
    errors = np.arange(10.0)
    assert error_at(errors, -errors, 0.8) == 3.5
    assert error_at(errors, errors, 0.5) == 7.0
    assert error_at(errors, errors, 1.0) == 4.5
    assert error_at(errors, -errors, 0.01) == 0.0


def test_pixels_without_an_error_are_ignored_and_no_pixel_gives_none():
    assert ause([1.0, np.nan, 3.0], [2, np.nan, 1]) == 0
    assert ause(np.ma.masked_greater([1.0, 9.0, 3.0], 5), [2, 3, 1]) == 0
    assert ause([np.nan], [1]) is None
    assert confidence_correlation([], []) is None


@pytest.mark.parametrize("shape", [(9, 13), (1, 6), (5, 1)])
def test_the_check_equals_its_definition_with_the_interpolation_of_scipy(shape):
    rng = np.random.default_rng(1)
    flow, back = (rng.normal(0, 2, (*shape, 2)).astype(np.float32) for _ in range(2))
    flow[0, 0] = 0
    confidence, rejected = forward_backward(flow, back)
    there = flow.astype(float)
    at = np.mgrid[: shape[0], : shape[1]] + there.transpose(2, 0, 1)[::-1]
    home = np.stack([map_coordinates(back[..., axis].astype(float), at, order=1) for axis in (0, 1)], axis=-1)
    inside = (at >= 0).all(axis=0) & (at[0] <= shape[0] - 1) & (at[1] <= shape[1] - 1)
    squared = ((there + home) ** 2).sum(axis=-1)
    assert np.allclose(confidence, np.where(inside, -np.sqrt(squared), -np.inf), rtol=0, atol=1e-12)
    allowed = 0.01 * ((there**2).sum(axis=-1) + (home**2).sum(axis=-1)) + 0.5
    assert np.array_equal(rejected, ~inside | (squared >= allowed))


def test_forward_backward_check_rejects_non_finite_flow_and_no_pixel_beside_it():
    flow = np.zeros((2, 3, 2), np.float32)
    flow[0, 0], back = np.nan, flow.copy()
    back[1, 2] = np.inf
    confidence, rejected = forward_backward(flow, back)
    lost = np.zeros((2, 3), bool)
    lost[0, 0] = lost[1, 2] = True
    assert np.array_equal(rejected, lost)
    assert np.isneginf(confidence[lost]).all()


@pytest.mark.parametrize(("axis", "length"), [(0, 20), (1, -20)])
@pytest.mark.parametrize(("return_length", "rejected"), [(17.3, False), (17.2, True), (23.1, False), (23.2, True)])
def test_the_tolerance_grows_with_the_squares_of_both_flows(axis, length, return_length, rejected):
    """For 17.3 px back from 20 px, 2.7^2 = 7.29 < 0.01 (20^2 + 17.3^2) + 0.5 = 7.49; for 17.2 px, 7.84 > 7.46. For
    23.1 px, 9.61 < 9.84; for 23.2 px, 10.24 > 9.88.
    """
    flow, back = np.zeros((41, 41, 2), np.float32), np.zeros((41, 41, 2), np.float32)
    flow[..., axis], back[..., axis] = length, -np.sign(length) * return_length
    assert forward_backward(flow, back)[1][20, 20] == rejected
