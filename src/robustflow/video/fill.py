"""Place decoded frames at their positions and fill the gaps.

Damage can remove any frame from a stream. The reference code numbers the remaining frames in output order, so every
lost frame shifts all later frames by one. Here, each frame is placed according to its presentation time. As in a video
player, a lost frame is replaced with the previous frame, or with the first decoded frame if there is none.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from ..errors import DataError
from .colour import I420

REORDER = 32
"""Number of frames buffered to restore the display order; H.264 requires at most 16."""


@dataclass
class Fill:
    """A record of the lost frames of a clip and their replacements."""

    count: int
    lost: list[tuple[int, int, int]] = field(default_factory=list)
    dropped: int = 0

    @property
    def frames_lost(self) -> int:
        """Return the number of replaced frames."""
        return sum(last - first + 1 for first, last, _ in self.lost)


def pictures_in_order(decoded: Iterable[tuple[int, I420]], fill: Fill) -> Iterator[tuple[int, I420]]:
    """Yield frames by ascending index without duplicates, using a bounded buffer."""
    waiting: list[tuple[int, int, I420]] = []
    last = -1
    for arrival, (index, picture) in enumerate(decoded):
        if index <= last or index >= fill.count or any(index == held[0] for held in waiting):
            fill.dropped += 1
            continue
        heapq.heappush(waiting, (index, arrival, picture))
        if len(waiting) > REORDER:
            last, _, earliest = heapq.heappop(waiting)
            yield last, earliest
    while waiting:
        last, _, earliest = heapq.heappop(waiting)
        yield last, earliest


def fill_lost(decoded: Iterable[tuple[int, I420]], fill: Fill) -> Iterator[tuple[int, I420]]:
    """Yield exactly `fill.count` frames with indices 0, 1, 2, ...; replace lost frames and record them in `fill`."""
    previous: tuple[int, I420] | None = None
    next_index = 0
    for index, picture in pictures_in_order(decoded, fill):
        if index > next_index:
            source, shown = previous or (index, picture)
            fill.lost.append((next_index, index - 1, source))
            for missing in range(next_index, index):
                yield missing, shown
        yield index, picture
        previous = (index, picture)
        next_index = index + 1
    if previous is None:
        raise DataError(
            f"none of the {fill.count} frames could be decoded from the damaged stream; choose a lower severity"
        )
    if next_index < fill.count:
        source, shown = previous
        fill.lost.append((next_index, fill.count - 1, source))
        for missing in range(next_index, fill.count):
            yield missing, shown
