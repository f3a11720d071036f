"""Compare blurs with direct sums, SciPy's filters and loops over pixels, in float64."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import correlate, gaussian_filter

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions.blur import CameraMotionBlur, GlassBlur
from robustflow.corruptions.kernels.disk import convolve_disk
from robustflow.corruptions.kernels.filters import gaussian_frame
from robustflow.corruptions.kernels.line_motion import line_kernel, move_frame

from .pictures import moved_along_a_line, noise

WIDTHS = st.integers(1, 40) | st.integers(600, 1400)
"""Widths of frames: narrower than the kernels, and wider than what is processed at a time."""


def scipy_blur(frame, sigma):
    planes = [gaussian_filter(frame[..., c].astype(np.float64), sigma, mode="nearest", truncate=4) for c in range(3)]
    return np.stack(planes, axis=-1)


@settings(max_examples=25)
@given(st.integers(1, 40), WIDTHS, st.floats(0.05, 9.0), st.integers(0, 99))
def test_gaussian_blur_accepts_any_size_and_filter_width(height, width, sigma, seed):
    frame = noise(height, width, seed)
    assert np.abs(gaussian_frame(frame, sigma) - scipy_blur(frame, sigma)).max() < 0.501


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


@settings(max_examples=25)
@given(
    st.integers(1, 40),
    WIDTHS,
    st.integers(1, 12) | st.floats(1, 12),
    st.sampled_from([0.0, 0.3, 0.5]),
    st.integers(0, 99),
)
def test_defocus_blur_accepts_any_size_and_radius(height, width, radius, smoothing, seed):
    frame = noise(height, width, seed)
    expected = direct(frame, disk_kernel(radius, smoothing))
    assert np.abs(convolve_disk(frame, radius, smoothing) - expected).max() < 0.501


@pytest.mark.parametrize(("radius", "sigma"), CameraMotionBlur.paper_severities)
@pytest.mark.parametrize("angle", [-44.0, -3.3, 20.0, 44.9, -91.7])
def test_blur_is_within_rounding_of_the_exact_integral_along_the_line(radius, sigma, angle):
    frame = np.random.default_rng(2).integers(0, 256, (37, 64, 3), dtype=np.uint8)
    got = move_frame(frame, line_kernel(radius, sigma, angle))
    assert np.abs(got - moved_along_a_line(frame, radius, sigma, angle)).max() < 0.55


def shuffled_by_loops(pixels, rng, reach, iterations, swap):
    """Shuffle pixel by pixel, starting at the bottom right, with offsets from the stream."""
    pixels = pixels.copy()
    height, width = pixels.shape[:2]
    for iteration in range(iterations):
        key = np.uint64(rng.spawn("shuffle", iteration).key)
        count = 0
        for y in range(height - reach, reach, -1):
            for x in range(width - reach, reach, -1):
                word = int(hash64(key, np.uint64(count // 4))) >> (16 * (count % 4)) & 0xFFFF
                count += 1
                dy, dx = divmod(word * (2 * reach) ** 2 >> 16, 2 * reach)
                there = y + dy - reach, x + dx - reach
                old = pixels[y, x].copy()
                pixels[y, x] = pixels[there]
                if swap:
                    pixels[there] = old
    return pixels


@pytest.mark.parametrize("severity", [1, 2, 5])
@pytest.mark.parametrize("variant", ["default", "paper"])
def test_the_frame_is_blurred_floored_shuffled_and_blurred(variant, severity):
    frame = np.random.default_rng(3).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    glass = GlassBlur(variant)
    rng = Rng.of("whole")
    sigma, reach, iterations = glass.parameter(severity)
    blurred = np.floor(gaussian_filter(frame.astype(np.float64), (sigma, sigma, 0), mode="nearest") + 1e-3)
    moved = shuffled_by_loops(blurred, rng, reach, iterations, swap=variant == "paper")
    expected = gaussian_filter(moved, (sigma, sigma, 0), mode="nearest")
    got = glass.apply(frame, glass.draw(rng, severity, (40, 50)), 0)
    assert np.abs(got - expected).max() < 0.501
