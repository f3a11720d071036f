"""One memory layout for compiled loops."""

from __future__ import annotations

import numpy as np

from ..sample import Frame


def contiguous(frame: Frame) -> Frame:
    """The frame, C-contiguous and read-only; copied only where it is not contiguous.

    Compiled loops are specialised by layout and by writability: with one of each, they are compiled once.

    >>> contiguous(np.zeros((4, 6, 3), np.uint8)[:, ::2]).flags.writeable
    False
    """
    view = np.ascontiguousarray(frame).view()
    view.flags.writeable = False
    return view
