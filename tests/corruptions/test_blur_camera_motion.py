"""Compare linear motion blur with a float64 sum over the taps."""

import numpy as np
import pytest

from robustflow.core.rng import Rng
from robustflow.corruptions.blur.fixed_kernels import CameraMotionBlur
from robustflow.corruptions.kernels.line_motion import line_kernel, move_frame, move_plane

from .line_motion import moved_along_a_line


@pytest.mark.parametrize(("radius", "sigma"), CameraMotionBlur.paper_severities)
@pytest.mark.parametrize("angle", [-44.0, -3.3, 20.0, 44.9, -91.7])
def test_blur_is_within_rounding_of_the_exact_integral_along_the_line(radius, sigma, angle):
    frame = np.random.default_rng(2).integers(0, 256, (37, 64, 3), dtype=np.uint8)
    got = move_frame(frame, line_kernel(radius, sigma, angle))
    assert np.abs(got - moved_along_a_line(frame, radius, sigma, angle)).max() < 0.55


def test_a_frame_smaller_than_the_kernel_keeps_its_brightness():
    frame = np.full((16, 16, 3), 200, np.uint8)
    assert (move_frame(frame, line_kernel(20, 15, 0.0)) == 200).all()
    assert (move_frame(np.full_like(frame, 255), line_kernel(20, 15, 30.0)) == 255).all()


def test_planes_come_in_fractions_of_a_grey_level():
    plane = np.random.default_rng(4).integers(0, 65281, (40, 30)).astype(np.uint16)
    got = move_plane(plane, line_kernel(12, 8, -70.0))
    assert np.abs(got - moved_along_a_line(plane / 256, 12, 8, -70.0)).max() < 0.55


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
