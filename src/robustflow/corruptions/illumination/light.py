"""Brighten frames. Darken frames."""

from __future__ import annotations

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.values import Table, look_up, shift_table


class HighLight(Corruption):
    """Brightens frames: V' = V + c on [0, 1]; the severity parameter is c (paper, "High-Light").

    In the reference code, this corruption is called `brightness` and is the only one in the family that truncates grey
    levels; `variant="reference"` truncates them, too.
    """

    name = "high_light"
    family = "illumination"
    paper_severities = (0.1, 0.2, 0.3, 0.4, 0.5)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Table:
        """Return the value table; nothing is random."""
        return shift_table(255.0 * self.parameter(severity), self.variant == "reference")

    def apply(self, frame: Frame, state: Table, index: int) -> Frame:
        """Brighten one frame."""
        return look_up(frame, state)


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
