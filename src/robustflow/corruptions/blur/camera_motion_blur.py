"""Camera motion blur."""

from __future__ import annotations

from typing import NamedTuple

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..kernels.line_motion import LineKernel, line_kernel, move_frame


class Shake(NamedTuple):
    """A severity: the movement of the camera."""

    radius: int
    """alpha, pixels: 2 * radius + 1 taps."""
    sigma: float
    """Standard deviation of the taps' weights, pixels."""


class CameraMotionBlur(Corruption):
    """Both frames smeared in one direction, as by a shaking camera (paper, appendix, blur).

    A severity is (radius alpha, standard deviation sigma) in pixels: 2 * alpha + 1 taps along a line, weighted by half
    a Gaussian that starts at the pixel itself, so that both frames also shift alike, by 2.2 to 11.5 px on average. The
    direction is uniform within +-45 degrees of the horizontal and shared by the frames. Borders repeat the edge pixel.

    The reference code drops the taps that reach beyond a small image and darkens it; here the edge is repeated.
    """

    name = "camera_motion_blur"
    family = "blur"
    level = Shake
    paper_severities = ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LineKernel:
        """Draw the direction; the state holds the taps."""
        shake: Shake = self.parameter(severity)
        return line_kernel(shake.radius, shake.sigma, rng.uniform(-45.0, 45.0))

    def apply(self, frame: Frame, state: LineKernel, index: int) -> Frame:
        """Smear one frame."""
        return move_frame(frame, state)
