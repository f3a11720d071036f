"""Apply Gaussian blur."""

from __future__ import annotations

from ...core.types import Frame
from ..base import Corruption
from ..kernels.separable import FLOOR, gaussian_frame


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
        """Blur one frame."""
        return gaussian_frame(frame, state, FLOOR if self.variant == "reference" else 0.0)
