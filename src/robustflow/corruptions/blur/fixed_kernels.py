"""Blur with one kernel for all pixels: a Gaussian, a disk, or a line."""

from __future__ import annotations

from typing import NamedTuple

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.disk import convolve_disk
from ..kernels.filters import FLOOR, gaussian_frame
from ..kernels.line_motion import LineKernel, line_kernel, move_frame


class GaussianBlur(Corruption):
    """Applies a Gaussian filter to both frames (paper, appendix "Corruption Details", blur).

    The severity parameter is the standard deviation in pixels. As in the reference code, edge pixels are repeated
    beyond the border, and the kernel is cut off at four standard deviations. `variant="reference"` truncates the result
    instead of rounding it.

    >>> GaussianBlur().parameter(5)
    6.0
    """

    name = "gaussian_blur"
    family = "blur"
    paper_severities = (1.0, 2.0, 3.0, 4.0, 6.0)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        return gaussian_frame(frame, state, FLOOR if self.variant == "reference" else 0.0)


class Disk(NamedTuple):
    radius: float  # radius of the disk, in pixels
    smoothing: float  # standard deviation of the anti-aliasing, in pixels


class DefocusBlur(Corruption):
    """Convolves both frames with an anti-aliased disk (paper, appendix "Corruption Details", blur).

    The severity parameters are (radius in pixels, standard deviation of the anti-aliasing). The paper describes a
    "circular mean filter". The reference code smooths a disk inside an array that is too small for the radii 8 and 10
    and mirrors the disk at the edge of the array, so these kernels sum to 1.013 and 1.011 and brighten the image. This
    behaviour is kept because it is part of the published results. Borders mirror the image without repeating the edge
    pixel. `variant="paper"` uses the disk without anti-aliasing; `variant="reference"` truncates instead of rounding.
    """

    name = "defocus_blur"
    family = "blur"
    level = Disk
    paper_severities = ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, float]:
        disk: Disk = self.parameter(severity)
        return float(disk.radius), 0.0 if self.variant == "paper" else float(disk.smoothing)

    def apply(self, frame: Frame, state: tuple[float, float], index: int) -> Frame:
        return convolve_disk(frame, *state, floor=self.variant == "reference")


class Shake(NamedTuple):
    radius: int  # radius alpha in pixels; the kernel has 2 * radius + 1 taps
    sigma: float  # standard deviation of the tap weights, in pixels


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
        shake: Shake = self.parameter(severity)
        return line_kernel(shake.radius, shake.sigma, rng.uniform(-45.0, 45.0))

    def apply(self, frame: Frame, state: LineKernel, index: int) -> Frame:
        return move_frame(frame, state)
