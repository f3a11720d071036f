"""Apply camera motion blur."""

from __future__ import annotations

from typing import NamedTuple

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..kernels.line_motion import LineKernel, line_kernel, move_frame


class Shake(NamedTuple):
    """Parameters of a severity."""

    radius: int
    """Radius alpha in pixels; the kernel has 2 * radius + 1 taps."""
    sigma: float
    """Standard deviation of the tap weights, in pixels."""


class CameraMotionBlur(Corruption):
    """Smears both frames in one direction, like camera shake (paper, appendix, blur).

    A severity is (radius alpha, standard deviation sigma) in pixels: 2 * alpha + 1 taps along a line, weighted by half
    a Gaussian that starts at the pixel itself, so both frames also shift by the same 2.2 to 11.5 px on average. The
    direction is uniform within +-45 degrees of the horizontal and shared by both frames. Borders repeat the edge pixel.
    In small images the reference code drops the taps outside the image, which darkens it; here the edge is repeated.
    """

    name = "camera_motion_blur"
    family = "blur"
    level = Shake
    paper_severities = ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LineKernel:
        """Draw the direction; the state contains the taps."""
        shake: Shake = self.parameter(severity)
        return line_kernel(shake.radius, shake.sigma, rng.uniform(-45.0, 45.0))

    def apply(self, frame: Frame, state: LineKernel, index: int) -> Frame:
        """Smear one frame."""
        return move_frame(frame, state)
