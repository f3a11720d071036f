"""Darken frames."""

from __future__ import annotations

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..kernels.value_table import Table, look_up, shift_table


class LowLight(Corruption):
    """Darkens frames: V' = V - c on [0, 1]; the severity parameter is c (paper, "Low-Light")."""

    name = "low_light"
    family = "illumination"
    paper_severities = (0.1, 0.2, 0.3, 0.4, 0.5)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Table:
        """Return the value table; nothing is random."""
        return shift_table(-255.0 * self.parameter(severity))

    def apply(self, frame: Frame, state: Table, index: int) -> Frame:
        """Darken one frame."""
        return look_up(frame, state)
