"""Change V in HSV with a lookup table.

Hue and saturation are unchanged, so every channel is scaled by V'/V with V = max(R, G, B). The corruption is a single
table of 256 x 256 bytes, which is indexed by V and the channel's value and computed once in float64.
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
    for y in range(source.shape[0]):
        s, o = source[y], out[y]
        for x in range(s.shape[0]):
            r, g, b = s[x, 0], s[x, 1], s[x, 2]
            row = table[max(r, max(g, b))]
            o[x, 0], o[x, 1], o[x, 2] = row[r], row[g], row[b]
