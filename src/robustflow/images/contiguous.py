"""Convert frames to the memory layout that compiled loops expect."""

from __future__ import annotations

import numpy as np

from ..sample import Frame


def contiguous(frame: Frame) -> Frame:
    """Return the frame as a C-contiguous, read-only array; copy it only if it is not contiguous.

    numba compiles a separate version for each memory layout and writability; if both are the same for all frames, it
    compiles only once.

    >>> contiguous(np.zeros((4, 6, 3), np.uint8)[:, ::2]).flags.writeable
    False
    """
    view = np.ascontiguousarray(frame).view()
    view.flags.writeable = False
    return view
