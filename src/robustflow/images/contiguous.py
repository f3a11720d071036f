"""Convert frames to the memory layout that compiled loops expect."""

from __future__ import annotations

import numpy as np

from ..sample import Frame


def contiguous(frame: Frame) -> Frame:
    """Return the frame as a C-contiguous, read-only array; copy it only if it is not contiguous."""
    view = np.ascontiguousarray(frame).view()
    view.flags.writeable = False
    return view
