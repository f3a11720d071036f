"""Compare disk sums with a direct convolution that uses the reference code's kernel."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import correlate

from robustflow.core.rng import Rng
from robustflow.corruptions.blur.fixed_kernels import DefocusBlur
from robustflow.corruptions.kernels.disk import convolve_disk

from .pictures import noise


def disk_kernel(radius, smoothing):
    """A uniform disk in the smallest array that contains it (at least 17 x 17), smoothed with OpenCV's Gaussian."""
    half = max(int(radius), 8)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    disk = (x**2 + y**2 <= radius**2).astype(np.float64)
    size = 1 if smoothing == 0 else 3 if radius <= 8 else 5
    return cv2.GaussianBlur(disk / disk.sum(), (size, size), sigmaX=smoothing)


def direct(frame, kernel):
    planes = [correlate(frame[..., c].astype(np.float64), kernel, mode="mirror") for c in range(3)]
    return np.clip(np.stack(planes, axis=-1), 0, 255)


@pytest.mark.parametrize(("severity", "grey"), [(4, 203), (5, 202)])
def test_the_two_widest_kernels_brighten(severity, grey):
    """They sum to 1.013 and 1.011."""
    blur, frame = DefocusBlur(), np.full((40, 50, 3), 200, np.uint8)
    assert (blur.apply(frame, blur.draw(Rng.of(0), severity, (40, 50)), 0) == grey).all()


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("shape", [(16, 16), (41, 53)])
def test_every_severity_rounds_the_float64_result(severity, shape):
    frame = noise(*shape)
    blur = DefocusBlur()
    expected = direct(frame, disk_kernel(*blur.parameter(severity)))
    assert np.abs(blur.apply(frame, blur.draw(Rng.of(0), severity, shape), 0) - expected).max() < 0.501


@pytest.mark.parametrize("severity", [1, 4, 5])
def test_wide_frames_have_no_seam_between_strips(severity):
    frame = noise(18, 1400)
    parameter = DefocusBlur().parameter(severity)
    assert np.abs(convolve_disk(frame, *parameter) - direct(frame, disk_kernel(*parameter))).max() < 0.501


def test_the_paper_variant_is_the_plain_disk_and_keeps_brightness():
    frame = np.full((30, 30, 3), 201, np.uint8)
    blur = DefocusBlur("paper")
    state = blur.draw(Rng.of(0), 5, (30, 30))
    assert state == (10, 0.0)
    assert (blur.apply(frame, state, 0) == 201).all()


def test_the_reference_variant_cuts_the_fraction_off():
    frame = noise(40, 40)
    blur = DefocusBlur("reference")
    error = direct(frame, disk_kernel(6, 0.5)) - blur.apply(frame, (6, 0.5), 0)
    assert error.min() > -0.01
    assert error.max() < 1.0


@settings(max_examples=25)
@given(
    st.integers(1, 40),
    st.integers(1, 40),
    st.integers(1, 12) | st.floats(1, 12),
    st.sampled_from([0.0, 0.3, 0.5]),
    st.integers(0, 99),
)
def test_defocus_blur_accepts_any_size_and_radius(height, width, radius, smoothing, seed):
    frame = noise(height, width, seed)
    expected = direct(frame, disk_kernel(radius, smoothing))
    assert np.abs(convolve_disk(frame, radius, smoothing) - expected).max() < 0.501
