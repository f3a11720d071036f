"""Compute key frames from the surrounding master frames, for several parameters at the same time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence

from ..sample import Frame

Make = Callable[[Callable[[int], Frame], int, Sequence[int]], dict[int, Frame]]


class AroundKeyFrames:
    """The key frames of one clip under one corruption.

    Recent frames are cached, because each key frame belongs to two pairs.

    Args:
        make: function that maps `frame_at`, a key frame index and `parameters` to a dict from parameter to RGB uint8
            (H, W, 3).
        frame_at: function that returns a master frame by index, RGB uint8 (H, W, 3).
        parameters: all parameters that will be needed; their frames are computed together.
        keep: number of key frames to cache.
    """

    def __init__(self, make: Make, frame_at: Callable[[int], Frame], parameters: Sequence[int], keep: int = 3) -> None:
        self._make = make
        self._frame_at = frame_at
        self._parameters = parameters
        self._keep = keep
        self._made: OrderedDict[int, dict[int, Frame]] = OrderedDict()

    def frame(self, centre: int, parameter: int) -> Frame:
        """Return key frame `centre` for a parameter, RGB uint8 (H, W, 3)."""
        if centre not in self._made:
            self._made[centre] = self._make(self._frame_at, centre, self._parameters)
            if len(self._made) > self._keep:
                self._made.popitem(last=False)
        return self._made[centre][parameter]
