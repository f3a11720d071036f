"""Apply object motion blur: average 2c + 1 master frames around a key frame (paper appendix, "Object Motion Blur")."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import UsageError
from ..sample import Frame


def mean_of_windows(frame_at: Callable[[int], Frame], centre: int, reaches: Sequence[int]) -> dict[int, Frame]:
    """Compute the mean over [centre - c, centre + c] for every c in `reaches`, in one pass over the longest window."""
    if not reaches or min(reaches) < 0:
        raise UsageError(f"invalid object motion blur window: {list(reaches)} frames on each side")
    reaches = tuple(dict.fromkeys(reaches))
    longest = max(reaches)
    sums: dict[int, np.ndarray] = {}
    for index in range(centre - longest, centre + longest + 1):
        frame = frame_at(index)
        for reach in reaches:
            if abs(index - centre) <= reach:
                if reach not in sums:
                    sums[reach] = frame.astype(np.uint32)
                else:
                    sums[reach] += frame
    return {reach: _rounded(sums[reach], 2 * reach + 1) for reach in reaches}


def _rounded(total: np.ndarray, count: int) -> Frame:
    return ((2 * total + count) // (2 * count)).astype(np.uint8)
