"""Brighten frames."""

from __future__ import annotations

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..kernels.value_table import Table, look_up, shift_table


class HighLight(Corruption):
    """Brightens frames: V' = V + c on [0, 1]; a severity is c (paper, "High-Light").

    The reference code calls this corruption `brightness` and truncates grey levels, unlike in the rest of this family;
    `variant="reference"` does so, too.
    """

    name = "high_light"
    family = "illumination"
    paper_severities = (0.1, 0.2, 0.3, 0.4, 0.5)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Table:
        """Nothing is random; the state is the table."""
        return shift_table(255.0 * self.parameter(severity), self.variant == "reference")

    def apply(self, frame: Frame, state: Table, index: int) -> Frame:
        """Brighten one frame."""
        return look_up(frame, state)
