"""Pixelate frames."""

from __future__ import annotations

from ...core.types import Frame
from ..base import Corruption
from ..kernels.box_resize import pixelated


class Pixelate(Corruption):
    """Shrinks frames with a box filter and enlarges them; the severity parameter is the scale factor (paper,
    "Pixelation").
    """

    name = "pixelate"
    family = "digital"
    paper_severities = (0.6, 0.5, 0.4, 0.3, 0.25)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        """Pixelate one frame."""
        return pixelated(frame, state)
