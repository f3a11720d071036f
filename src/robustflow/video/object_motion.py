"""Apply object motion blur: average 2c + 1 master frames around a key frame (paper appendix, "Object Motion Blur")."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import UsageError
from ..sample import Frame


def mean_of_windows(frame_at: Callable[[int], Frame], centre: int, reaches: Sequence[int]) -> dict[int, Frame]:
    """Compute the mean over [centre - c, centre + c] for every c in `reaches`, in one pass over the longest window.

    Args:
        frame_at: function that returns a master frame by index, RGB uint8 (H, W, 3); called in ascending order.
        centre: index of the key frame.
        reaches: values of c, each at least 0.

    Returns:
        A dict from c to the mean, RGB uint8 (H, W, 3), rounded to the nearest integer; there are no ties because the
        number of frames is odd.

    >>> import numpy as np
    >>> ramp = lambda index: np.full((1, 1, 3), index * index, np.uint8)
    >>> {c: int(mean[0, 0, 0]) for c, mean in mean_of_windows(ramp, 5, [0, 1, 3]).items()}
    {0: 25, 1: 26, 3: 29}
    """
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
