"""Key frames that are made from the master frames around them, for several parameters at once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence

from ..sample import Frame

Make = Callable[[Callable[[int], Frame], int, Sequence[int]], dict[int, Frame]]


class AroundKeyFrames:
    """Key frames of one clip under one corruption; the last few are remembered, since every key frame serves two pairs.

    Args:
        make: function of `frame_at`, a key frame and `parameters`: parameter -> RGB uint8 (H, W, 3).
        frame_at: RGB uint8 of a master frame.
        parameters: those that will be needed; all are made at once.
        keep: key frames remembered.
    """

    def __init__(self, make: Make, frame_at: Callable[[int], Frame], parameters: Sequence[int], keep: int = 3) -> None:
        self._make = make
        self._frame_at = frame_at
        self._parameters = parameters
        self._keep = keep
        self._made: OrderedDict[int, dict[int, Frame]] = OrderedDict()

    def frame(self, centre: int, parameter: int) -> Frame:
        """Key frame `centre` for a parameter."""
        if centre not in self._made:
            self._made[centre] = self._make(self._frame_at, centre, self._parameters)
            if len(self._made) > self._keep:
                self._made.popitem(last=False)
        return self._made[centre][parameter]
