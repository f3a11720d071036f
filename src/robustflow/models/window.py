"""The window of a multi-frame model: the frames that it receives around a pair, and the behaviour at the ends of a
sequence.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

from ..core.errors import ModelError

Ends = Literal["repeat", "short", "inside"]


class Window(NamedTuple):
    """Frames around a pair, as offsets from frame 1 of the pair; frame 1 has offset 0, and frame 2 has offset 1."""

    before: int
    after: int = 0
    ends: Ends = "repeat"

    @property
    def reach(self) -> int:
        """The largest distance between a frame and the pair, in frames."""
        return self.before + self.after

    def offsets(self, there: range) -> tuple[int, ...]:
        """Return the offsets of the frames that the model receives, in order."""
        offsets = range(-self.before, self.after + 2)
        if self.ends == "repeat":
            return tuple(min(max(offset, there.start), there.stop - 1) for offset in offsets)
        if self.ends == "inside":
            start = max(there.start, min(offsets.start, there.stop - len(offsets)))
            offsets = range(start, start + len(offsets))
        return tuple(offset for offset in offsets if offset in there)

    def record(self) -> dict[str, Any]:
        """Return the window's entry in a run's identity."""
        return self._asdict()


def window_of(model: Any) -> Window:
    """Return the window that a multi-frame model declares."""
    declared = model.window
    parts = tuple(declared) if isinstance(declared, tuple | list) else ()
    counts, ends = parts[:2], parts[2:]
    counts_valid = len(counts) == 2 and all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in counts)
    if not (counts_valid and sum(counts) and ends in ((), *((end,) for end in get_args(Ends)))):
        raise ModelError(
            f"the model's window is {declared!r}; declare (before, after), the numbers of frames before frame 1 and "
            "after frame 2, at least one in total, and optionally the behaviour at the ends: "
            f"{', '.join(get_args(Ends))}"
        )
    return Window(*parts)


def place_of_pair(offsets: tuple[int, ...]) -> int:
    """Return the index of frame 1 of the pair."""
    return offsets.index(1) - 1
