"""Apply H.264 compression and bit errors to a few frames of the user's clip, as in GoPro-FC."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from ...core.errors import DataError
from ...core.types import Frame
from .clip import write_clip
from .codec import i420_to_rgb, lossless, rgb_to_i420
from .container import open_video
from .variants import corrupted_stream

DEFAULT_RATE = Fraction(30)
"""Default frame rate for folders of images, in frames per second."""


def frame_rate(path: Path) -> Fraction:
    """Return the mean frame rate of a video file."""
    if path.is_dir():
        return DEFAULT_RATE
    with open_video(path) as container:
        stream = container.streams.video[0]
        return Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)


class ShortClip:
    """A part of a clip, losslessly encoded once, like the benchmark's master, in constant memory."""

    def __init__(self, frames: Iterable[Frame], rate: Fraction, folder: Path) -> None:
        rest = iter(frames)
        first = next(rest, None)
        if first is None:
            raise DataError("a clip needs at least one frame")
        size = first.shape[:2]

        def pictures() -> Iterable[np.ndarray]:
            yield rgb_to_i420(first)
            for number, frame in enumerate(rest, 1):
                if frame.shape[:2] != size:
                    raise DataError(
                        f"frame {number} differs in size from the first; all frames of a clip must be the same size"
                    )
                yield rgb_to_i420(frame)

        self._master = write_clip(folder / "master.mp4", pictures(), size, rate, lossless("veryfast"))

    def corrupted(self, corruption: str, parameter: int, wanted: range) -> tuple[list[Frame], bool]:
        """Corrupt the entire part and return some of its frames."""
        master = self._master
        stream = corrupted_stream(master, corruption, parameter)
        frames = []
        for index, picture in stream.pictures:
            if index in wanted:
                frames.append(i420_to_rgb(picture, master.height, master.width))
            if index == wanted[-1]:
                break
        return frames, stream.damage is None or stream.damage.bytes_changed > 0
