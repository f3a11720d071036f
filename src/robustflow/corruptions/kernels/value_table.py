"""Change V in HSV by a table.

Hue and saturation stay, so every channel is scaled by V'/V where V = max(R, G, B): one table of 256 x 256 bytes, row V,
column the channel's value, holds the whole corruption, and is computed once in float64.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...sample import Frame
from .rounding import to_bytes

Table = npt.NDArray[np.uint8]


def look_up(frame: Frame, table: Table) -> Frame:
    """A new frame with every channel replaced by `table[V, channel]`."""
    source = np.require(frame, requirements=("C", "W"))
    out = np.empty_like(source)
    _look_up(source, table, out)
    return out


@lru_cache(maxsize=32)
def shift_table(shift: float, floor: bool = False) -> Table:
    """The table for V' = V + shift grey levels."""
    return value_table(np.arange(256.0) + shift, floor)


@lru_cache(maxsize=32)
def gain_table(factor: float) -> Table:
    """The table for V' = V * factor."""
    return value_table(np.arange(256.0) * factor)


def value_table(new_value: npt.NDArray[np.float64], floor: bool = False) -> Table:
    """For V = 0 .. 255 (rows) and a channel's value (columns), the channel's new value, uint8 (256, 256).

    `new_value` is V' in grey levels for V = 0 .. 255, float64 (256,); it is clipped to [0, 255]. Black has no hue and
    becomes grey V'. A channel above V does not occur.

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
    for y in range(source.shape[0]):
        s, o = source[y], out[y]
        for x in range(s.shape[0]):
            r, g, b = s[x, 0], s[x, 1], s[x, 2]
            row = table[max(r, max(g, b))]
            o[x, 0], o[x, 1], o[x, 2] = row[r], row[g], row[b]
