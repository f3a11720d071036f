"""Apply defocus blur by convolution with a disk; see disk.py."""

from __future__ import annotations

from typing import NamedTuple

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.disk import convolve_disk


class Disk(NamedTuple):
    """Parameters for one severity."""

    radius: float
    """Radius of the disk, in pixels."""
    smoothing: float
    """Standard deviation of the anti-aliasing, in pixels."""


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
        """Return the radius and the anti-aliasing (0 for the variant `paper`); nothing is random."""
        disk: Disk = self.parameter(severity)
        return float(disk.radius), 0.0 if self.variant == "paper" else float(disk.smoothing)

    def apply(self, frame: Frame, state: tuple[float, float], index: int) -> Frame:
        """Convolve one frame with the disk."""
        return convolve_disk(frame, *state, floor=self.variant == "reference")
