"""Brighten or darken frames, or expose one frame of a pair differently: changes of V in HSV.

Hue and saturation are unchanged, so every channel is scaled by V'/V with V = max(R, G, B). The corruption is a single
table of 256 x 256 bytes, which is indexed by V and the channel's value and computed once in float64.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit
from ..core.rng import Rng
from ..core.types import Frame
from .corruption import Corruption
from .kernels.filters import to_bytes


class HighLight(Corruption):
    """Brightens frames: V' = V + c on [0, 1]; the severity parameter is c (paper, "High-Light").

    In the reference code, this corruption is called `brightness` and is the only one in the family that truncates grey
    levels; `variant="reference"` truncates them, too.
    """

    name = "high_light"
    paper_severities = (0.1, 0.2, 0.3, 0.4, 0.5)
    sign = 1.0

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Table:
        floor = self.variant == "reference" and self.sign > 0
        return shift_table(self.sign * 255.0 * self.parameter(severity), floor)

    def apply(self, frame: Frame, state: Table, index: int) -> Frame:
        return look_up(frame, state)


class LowLight(HighLight):
    """Darkens frames: V' = V - c on [0, 1]; the severity parameter is c (paper, "Low-Light")."""

    name = "low_light"
    sign = -1.0


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
    paper_severities = (0.4, 0.8, 1.2, 1.6, 2.0)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LightState:
        return LightState(gain_table(2.0 ** self.parameter(severity)), rng.integer(0, 2))

    def apply(self, frame: Frame, state: LightState, index: int) -> Frame:
        return look_up(frame, state.table) if index % 2 == state.exposed else np.array(frame, order="C")


class UnderExposure(OverExposure):
    """Like `OverExposure`, with negative ev (paper, "Under Exposure")."""

    name = "under_exposure"
    paper_severities = (-0.4, -0.8, -1.2, -1.6, -2.0)


Table = npt.NDArray[np.uint8]


def look_up(frame: Frame, table: Table) -> Frame:
    """Return a new frame with every channel replaced by `table[V, channel]`."""
    source = np.require(frame, requirements=("C", "W"))
    out = np.empty_like(source)
    _look_up(source, table, out)
    return out


@lru_cache(maxsize=32)
def shift_table(shift: float, floor: bool = False) -> Table:
    """Return the table for V' = V + shift; `shift` is in grey levels."""
    return value_table(np.arange(256.0) + shift, floor)


@lru_cache(maxsize=32)
def gain_table(factor: float) -> Table:
    """Return the table for V' = V * factor."""
    return value_table(np.arange(256.0) * factor)


def value_table(new_value: npt.NDArray[np.float64], floor: bool = False) -> Table:
    """Return a table of new channel values for each V (rows) and old channel value (columns), uint8 (256, 256).

    >>> table = value_table(np.arange(256.0) + 51.0)
    >>> int(table[102, 102]), int(table[102, 50]), int(table[0, 0])
    (153, 75, 51)
    """
    value = np.arange(256.0)
    changed = np.clip(new_value, 0.0, 255.0)
    table = value[None, :] * changed[:, None] / np.maximum(value, 1.0)[:, None]
    table[0] = changed[0]
    return to_bytes(table, floor)


@njit(cache=True, nogil=True)
def _look_up(source: Any, table: Any, out: Any) -> None:
    """Map each channel by the table's row of the pixel's largest channel, which is V of HSV."""
    for y in range(source.shape[0]):
        s, o = source[y], out[y]
        for x in range(s.shape[0]):
            r, g, b = s[x, 0], s[x, 1], s[x, 2]
            row = table[np.maximum(r, np.maximum(g, b))]
            o[x, 0], o[x, 1], o[x, 2] = row[r], row[g], row[b]
