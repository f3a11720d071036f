"""Compare linear motion blur with a float64 sum over the taps."""

import math

import numpy as np
import pytest

from robustflow.corruptions.blur.camera_motion_blur import CameraMotionBlur
from robustflow.corruptions.kernels.line_motion import line_kernel, move_frame, move_plane
from robustflow.random.rng import Rng


def naive(image, radius, sigma, angle):
    """Sum over the taps: tap i is the image shifted back by i pixels along the angle, with replicated borders."""
    taps = 2 * radius + 1
    weights = np.array([math.exp(-(i**2) / (2 * sigma**2)) for i in range(taps)])
    weights /= weights.sum()
    height, width = image.shape[:2]
    total = np.zeros(image.shape)
    for i, weight in enumerate(weights):
        dy = math.ceil(i * math.sin(math.radians(angle)) - 0.5)
        dx = math.ceil(i * math.cos(math.radians(angle)) - 0.5)
        rows = np.clip(np.arange(height) + dy, 0, height - 1)
        columns = np.clip(np.arange(width) + dx, 0, width - 1)
        total += weight * image[rows][:, columns]
    return total


@pytest.mark.parametrize(("radius", "sigma"), CameraMotionBlur.paper_severities)
@pytest.mark.parametrize("angle", [-44.0, -3.3, 20.0, 44.9, -91.7])
def test_frames(radius, sigma, angle):
    frame = np.random.default_rng(2).integers(0, 256, (37, 64, 3), dtype=np.uint8)
    got = move_frame(frame, line_kernel(radius, sigma, angle))
    assert np.abs(got - naive(frame, radius, sigma, angle)).max() < 0.55


def test_a_frame_smaller_than_the_kernel_keeps_its_brightness():
    frame = np.full((16, 16, 3), 200, np.uint8)
    assert (move_frame(frame, line_kernel(20, 15, 0.0)) == 200).all()
    assert (move_frame(np.full_like(frame, 255), line_kernel(20, 15, 30.0)) == 255).all()


def test_planes_come_in_fractions_of_a_grey_level():
    plane = np.random.default_rng(4).integers(0, 65281, (40, 30)).astype(np.uint16)
    got = move_plane(plane, line_kernel(12, 8, -70.0))
    assert np.abs(got - naive(plane / 256, 12, 8, -70.0)).max() < 0.55


def test_weights_sum_to_one_and_fall_along_the_line():
    kernel = line_kernel(20, 15, 45.0)
    assert int(kernel.weights.sum()) == 65535
    assert (np.diff(kernel.weights.astype(int)) <= 1).all()
    assert kernel.offsets[0].tolist() == [0, 0]
    assert (kernel.offsets >= 0).all()


def test_the_direction_is_drawn_once_within_45_degrees():
    blur = CameraMotionBlur()
    ends = np.array([blur.draw(Rng.of(seed), 5, (64, 64)).offsets[-1] for seed in range(200)])
    angles = np.degrees(np.arctan2(ends[:, 0], ends[:, 1]))
    assert np.abs(angles).max() <= 46
    assert angles.min() < -35
    assert angles.max() > 35
