"""Simulate a rolling shutter: take each row of a key frame from the master frame at the row's readout time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import UsageError
from ..sample import Frame


def rolling_frames(frame_at: Callable[[int], Frame], centre: int, readouts: Sequence[int]) -> dict[int, Frame]:
    """Compute a key frame for several readout times, in one pass over the longest readout."""
    if not readouts or min(readouts) < 0:
        raise UsageError(f"invalid rolling shutter readout times: {list(readouts)} frames")
    reach = (max(readouts) + 1) // 2
    frames: dict[int, Frame] = {}
    for index in range(centre - reach, centre + reach + 1):
        frame = frame_at(index)
        for readout in dict.fromkeys(readouts):
            rows = row_offsets(frame.shape[0], readout) == index - centre
            frames.setdefault(readout, np.empty_like(frame))[rows] = frame[rows]
    return frames


def row_offsets(height: int, readout: int) -> np.ndarray:
    """Return the master frame for each row relative to the key frame, int (height,)."""
    return (readout * (2 * np.arange(height) + 1 - height) + height) // (2 * height)
