"""H.264 and bit errors on a few frames of a user's clip, applied as in GoPro-FC."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..sample import Frame
from .clip import write_clip
from .codec import lossless
from .colour import i420_to_rgb, rgb_to_i420
from .container import open_video
from .variants import corrupted_stream

DEFAULT_RATE = Fraction(30)
"""Frames per second assumed for pictures."""


def frame_rate(path: Path) -> Fraction:
    """The mean frame rate of a video file; `DEFAULT_RATE` for a folder of pictures or a file that states none.

    Raises:
        DataError: the file is not a readable video.
    """
    if path.is_dir():
        return DEFAULT_RATE
    with open_video(path) as container:
        stream = container.streams.video[0]
        return Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)


class ShortClip:
    """A part of a clip, encoded once without loss, as the benchmark's master is; memory does not grow with its length.

    Unlike a prepared clip it is not interpolated in time, and it is encoded with a faster preset: bit errors, which are
    counted in bytes, hit about as often but not the same ones.

    Args:
        frames: RGB uint8 (H, W, 3) in order.
        rate: frames per second, which decides what a bit rate buys.
        folder: an empty one for the encoded clip.

    Raises:
        DataError: no frames, or frames of different size.
    """

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
                        f"frame {number} differs in size from the first; all frames of a clip must have one size"
                    )
                yield rgb_to_i420(frame)

        self._master = write_clip(folder / "master.mp4", pictures(), size, rate, lossless("veryfast"))

    def corrupted(self, corruption: str, parameter: int, wanted: range) -> tuple[list[Frame], bool]:
        """Some frames after a corruption of the whole part.

        Args:
            corruption: "h264_crf", "h264_abr" or "bit_error".
            parameter: CRF, bit/s, or N of the noise filter.
            wanted: their numbers, ascending.

        Returns:
            RGB uint8 (H, W, 3) each, and whether anything was changed up to the last of them; a stream that is too
            short for an amount of bit errors is not.
        """
        master = self._master
        stream = corrupted_stream(master, corruption, parameter)
        frames = []
        for index, picture in stream.pictures:
            if index in wanted:
                frames.append(i420_to_rgb(picture, master.height, master.width))
            if index == wanted[-1]:
                break
        return frames, stream.damage is None or stream.damage.bytes_changed > 0
