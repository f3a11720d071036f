"""Apply camera motion blur."""

from __future__ import annotations

from typing import NamedTuple

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.line_motion import LineKernel, line_kernel, move_frame


class Shake(NamedTuple):
    """Parameters for one severity."""

    radius: int
    """Radius alpha in pixels; the kernel has 2 * radius + 1 taps."""
    sigma: float
    """Standard deviation of the tap weights, in pixels."""


class CameraMotionBlur(Corruption):
    """Smears both frames in one direction, like camera shake (paper, appendix, blur).

    The severity parameters are (radius alpha, standard deviation sigma) in pixels. The kernel has 2 * alpha + 1 taps
    along a line, weighted by one half of a Gaussian that starts at the pixel itself, so it also shifts the content of
    both frames equally, by 2.2 to 11.5 px on average depending on the severity. The direction is uniformly distributed
    within +-45 degrees of the horizontal and shared by both frames. Edge pixels are repeated beyond the border. In
    small images, the reference code drops the taps outside the image, which darkens the result; this implementation
    does not.
    """

    name = "camera_motion_blur"
    family = "blur"
    temporal = True
    level = Shake
    paper_severities = ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LineKernel:
        """Draw the direction and return the taps as the state."""
        shake: Shake = self.parameter(severity)
        return line_kernel(shake.radius, shake.sigma, rng.uniform(-45.0, 45.0))

    def apply(self, frame: Frame, state: LineKernel, index: int) -> Frame:
        """Blur one frame along the line."""
        return move_frame(frame, state)
