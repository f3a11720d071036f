"""Overexpose one frame of a pair. Underexpose one frame of a pair."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.values import Table, gain_table, look_up


class LightState(NamedTuple):
    """The value table, and whether to overexpose frames with even or odd indices."""

    table: Table
    exposed: int


class OverExposure(Corruption):
    """Applies V' = V 2**ev to one of two successive frames, chosen at random (paper, "Over Exposure").

    The severity parameter is ev. The paper says "one image"; it is chosen at random, as in the reference code. In
    clips, every other frame is changed.
    """

    name = "over_exposure"
    temporal = True
    family = "illumination"
    paper_severities = (0.4, 0.8, 1.2, 1.6, 2.0)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LightState:
        """Choose at random which frame to change; the state also contains the value table."""
        return LightState(gain_table(2.0 ** self.parameter(severity)), rng.integer(0, 2))

    def apply(self, frame: Frame, state: LightState, index: int) -> Frame:
        """Change the exposure of one frame, or copy it."""
        return look_up(frame, state.table) if index % 2 == state.exposed else np.array(frame, order="C")


class UnderExposure(OverExposure):
    """Like `OverExposure`, with negative ev (paper, "Under Exposure")."""

    name = "under_exposure"
    paper_severities = (-0.4, -0.8, -1.2, -1.6, -2.0)
