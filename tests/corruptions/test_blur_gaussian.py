"""Compare the Gaussian filter with SciPy's filter in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from robustflow.core.rng import Rng
from robustflow.corruptions.blur.fixed_kernels import GaussianBlur
from robustflow.corruptions.kernels.filters import gaussian_frame, gaussian_plane

from .pictures import noise


def scipy_blur(frame, sigma):
    planes = [gaussian_filter(frame[..., c].astype(np.float64), sigma, mode="nearest", truncate=4) for c in range(3)]
    return np.stack(planes, axis=-1)


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("shape", [(16, 16), (37, 61)])
def test_every_severity_rounds_the_float64_result(severity, shape):
    frame = noise(*shape)
    blur = GaussianBlur()
    expected = scipy_blur(frame, blur.parameter(severity))
    got = blur.apply(frame, blur.draw(Rng.of(0), severity, shape), 0)
    assert np.abs(got - expected).max() < 0.501


def test_the_reference_variant_cuts_the_fraction_off_but_leaves_white_white():
    blur = GaussianBlur("reference")
    frame = noise(20, 30)
    error = scipy_blur(frame, 2.0) - blur.apply(frame, 2.0, 0)
    assert error.min() > -0.01
    assert error.max() < 1.0
    white = np.full((20, 30, 3), 255, np.uint8)
    assert (blur.apply(white, 6.0, 0) == 255).all()


@settings(max_examples=25)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.05, 9.0), st.integers(0, 99))
def test_gaussian_blur_accepts_any_size_and_filter_width(height, width, sigma, seed):
    frame = noise(height, width, seed)
    assert np.abs(gaussian_frame(frame, sigma) - scipy_blur(frame, sigma)).max() < 0.501


def test_a_plane_is_not_rounded():
    plane = np.random.default_rng(1).normal(size=(33, 50)).astype(np.float32)
    expected = gaussian_filter(plane.astype(np.float64), 3.0, mode="nearest", truncate=4)
    assert np.abs(gaussian_plane(plane, 3.0) - expected).max() < 1e-6
