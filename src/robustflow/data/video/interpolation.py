"""Increase the frame rate of a clip with an interpolator, as a stream, so that the clip can have any length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from ...core.errors import AssetError, UsageError
from ...core.types import Frame

WINDOW = 4
"""Number of frames passed to an interpolator: the two frames around the gap and one more on each side, as required by
FLAVR.
"""


class Interpolator(Protocol):
    """Interpolates frames between two frames."""

    name: str

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        """Return the `factor - 1` evenly spaced frames between `window[1]` and `window[2]`."""

    def describe(self) -> dict[str, Any]:
        """Return everything that affects the output (method, checkpoint hash, versions), for the manifest."""


def load_interpolator(
    name: str | None, factor: int, checkpoint: Path | None, device: str = "cpu"
) -> Interpolator | None:
    """Return the requested interpolator, or None if the factor is 1."""
    if factor == 1:
        return None
    if name == "flow":
        from .flow_interpolator import FlowInterpolator

        return FlowInterpolator()
    if name == "flavr":
        if checkpoint is None:
            raise AssetError(
                "FLAVR requires --checkpoint FLAVR_4x.pth (the official 4x weights); alternatively, "
                "use --interpolator flow, which requires no weights and is recorded in every result"
            )
        from .flavr_interpolator import FlavrInterpolator

        return FlavrInterpolator(checkpoint, device)
    problem = "none was specified" if name is None else f"'{name}' is unknown"
    raise UsageError(
        f"a factor of {factor} requires an interpolator, but {problem}: choose --interpolator flavr (as in the paper, "
        "requires --checkpoint) or flow (bidirectional DIS flow, requires no weights)"
    )


def interpolated_count(count: int, factor: int) -> int:
    """Return the number of frames that `interpolate` produces from `count` frames."""
    return count if factor == 1 else max(0, (count - WINDOW + 1) * factor + 1)


def interpolate(frames: Iterable[Frame], interpolator: Interpolator, factor: int) -> Iterator[Frame]:
    """Yield all frames except the first and the last, with `factor - 1` new frames in every gap."""
    return fill_gaps(windows(frames), interpolator, factor)


def windows(frames: Iterable[Frame]) -> Iterator[tuple[Frame, ...]]:
    """Yield the four frames around every gap that has two frames on either side."""
    window: tuple[Frame, ...] = ()
    for frame in frames:
        window = (*window[-WINDOW + 1 :], frame)
        if len(window) == WINDOW:
            yield window


def fill_gaps(
    around: Iterable[tuple[Frame, ...]], interpolator: Interpolator, factor: int, first: bool = True
) -> Iterator[Frame]:
    """Yield, for each window, the new frames and the frame that follows; with `first`, also the frame before them."""
    for window in around:
        if first:
            yield window[1]
            first = False
        yield from interpolator.between(window, factor)
        yield window[2]
