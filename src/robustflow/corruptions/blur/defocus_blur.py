"""Defocus blur: frames are convolved with a disk, see disk.py."""

from __future__ import annotations

from typing import NamedTuple

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..kernels.disk import convolve_disk


class Disk(NamedTuple):
    """A severity: the disk."""

    radius: float
    """Pixels."""
    smoothing: float
    """Standard deviation of the anti-aliasing, pixels."""


class DefocusBlur(Corruption):
    """Both frames convolved with an anti-aliased disk (paper, appendix "Corruption Details", blur).

    A severity is (radius in pixels, standard deviation of the anti-aliasing). The paper says "circular mean filter";
    the reference code smooths a disk inside an array that at radius 8 and 10 is too small for it, and mirrors it at the
    array's edge, so that these kernels sum to 1.013 and 1.011 and brighten the image. That is kept: it is what the
    published numbers measured. Borders mirror the image without repeating the edge pixel. `variant="paper"` is the
    plain disk; `variant="reference"` cuts the fraction off instead of rounding.
    """

    name = "defocus_blur"
    family = "blur"
    level = Disk
    paper_severities = ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, float]:
        """Nothing is random; the state is (radius, anti-aliasing), the latter 0 in the variant `paper`."""
        disk: Disk = self.parameter(severity)
        return float(disk.radius), 0.0 if self.variant == "paper" else float(disk.smoothing)

    def apply(self, frame: Frame, state: tuple[float, float], index: int) -> Frame:
        """Convolve one frame."""
        return convolve_disk(frame, *state, floor=self.variant == "reference")
