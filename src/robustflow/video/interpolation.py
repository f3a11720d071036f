"""Raise the frame rate of a clip of any length with an interpolator, streaming."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from ..errors import AssetError, UsageError
from ..sample import Frame

WINDOW = 4
"""Frames an interpolator sees: the two around the gap and one more on each side, as FLAVR was built."""


class Interpolator(Protocol):
    """Makes the frames between two frames.

    Attributes:
        name: as `--interpolator` and manifests say it.
    """

    name: str

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        """The `factor - 1` frames at even times between `window[1]` and `window[2]`.

        Args:
            window: four consecutive frames, RGB uint8 (H, W, 3).
            factor: how many times the frame rate.

        Raises:
            UsageError: a factor that it cannot do.
        """

    def describe(self) -> dict[str, Any]:
        """What determines its output (method, checkpoint hash, versions), for the manifest."""


def load_interpolator(
    name: str | None, factor: int, checkpoint: Path | None, device: str = "cpu"
) -> Interpolator | None:
    """The requested interpolator; None if the factor is 1 and nothing has to be interpolated.

    Raises:
        UsageError: a factor above 1 without a named interpolator, or an unknown name.
        AssetError: FLAVR without its checkpoint.
    """
    if factor < 1:
        raise UsageError(f"--factor {factor}: give 1 (no interpolation) or more")
    if factor == 1:
        return None
    if name == "flow":
        from .flow_interpolator import FlowInterpolator

        return FlowInterpolator()
    if name == "flavr":
        if checkpoint is None:
            raise AssetError(
                "FLAVR needs its weights: give --checkpoint FLAVR_4x.pth (the official 4x checkpoint), "
                "or choose --interpolator flow, which needs none and is named in every result"
            )
        from .flavr_interpolator import FlavrInterpolator

        return FlavrInterpolator(checkpoint, device)
    given = "none was named" if name is None else f"'{name}' is not one"
    raise UsageError(
        f"a frame rate times {factor} needs an interpolator, and {given}: choose --interpolator flavr (the paper's, "
        "needs --checkpoint) or flow (bidirectional DIS flow, needs no weights)"
    )


def interpolated_count(count: int, factor: int) -> int:
    """How many frames `interpolate` makes of `count`.

    >>> interpolated_count(100, 4), interpolated_count(100, 1)
    (389, 100)
    """
    return count if factor == 1 else max(0, (count - WINDOW + 1) * factor + 1)


def interpolate(frames: Iterable[Frame], interpolator: Interpolator, factor: int) -> Iterator[Frame]:
    """Yield the frames from the second to the last but one, with `factor - 1` new ones in every gap.

    The clip's first and last frame only serve as neighbours, as in FLAVR's own script: so frame 0 of the result is
    frame 1 of the source, for every interpolator. Holds four frames.
    """
    return fill_gaps(windows(frames), interpolator, factor)


def windows(frames: Iterable[Frame]) -> Iterator[tuple[Frame, ...]]:
    """The four frames around every gap that has a frame on either side of it."""
    window: tuple[Frame, ...] = ()
    for frame in frames:
        window = (*window[-WINDOW + 1 :], frame)
        if len(window) == WINDOW:
            yield window


def fill_gaps(
    around: Iterable[tuple[Frame, ...]], interpolator: Interpolator, factor: int, first: bool = True
) -> Iterator[Frame]:
    """For each window the new frames and the frame after them; with `first`, also the frame before them."""
    for window in around:
        if first:
            yield window[1]
            first = False
        yield from interpolator.between(window, factor)
        yield window[2]
