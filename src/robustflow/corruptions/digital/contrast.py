"""Reduce the contrast."""

from __future__ import annotations

import cv2
import numpy as np

from ...core.types import Frame
from ..base import Corruption
from ..kernels.values import to_bytes


class Contrast(Corruption):
    """Reduces the contrast: out = (I - mean) c + mean; the severity parameter is c (paper, "Contrast").

    The mean is computed per channel, as in the reference code; `variant="paper"` uses one mean for the entire frame, as
    in the paper's formula. `variant="reference"` truncates grey levels, as the reference code does.
    """

    name = "contrast"
    family = "digital"
    paper_severities = (0.4, 0.3, 0.2, 0.1, 0.05)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        """Reduce the contrast of one frame."""
        source = np.ascontiguousarray(frame)
        sums = np.array(cv2.sumElems(source)[:3])
        pixels = source.shape[0] * source.shape[1]
        means = np.full(3, sums.sum() / (3 * pixels)) if self.variant == "paper" else sums / pixels
        levels = (np.arange(256.0)[None, :] - means[:, None]) * state + means[:, None]
        return np.asarray(cv2.LUT(source, to_bytes(levels, self.variant == "reference").T[None]))
