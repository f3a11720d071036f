"""Apply H.264 compression and bit errors to a few frames of the user's clip, as in GoPro-FC."""

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
"""Default frame rate for folders of images, in frames per second."""


def frame_rate(path: Path) -> Fraction:
    """Return the mean frame rate of a video file.

    For a folder of images, or if the file does not declare a rate, the result is `DEFAULT_RATE`.

    Raises:
        DataError: the file is not a readable video.
    """
    if path.is_dir():
        return DEFAULT_RATE
    with open_video(path) as container:
        stream = container.streams.video[0]
        return Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)


class ShortClip:
    """A part of a clip, losslessly encoded once, like the benchmark's master, in constant memory.

    Unlike prepared clips, it is not interpolated in time, and it is encoded with a faster preset: bit errors are about
    as frequent, since their rate is per byte, but affect different bytes.

    Args:
        frames: frames in order, RGB uint8 (H, W, 3).
        rate: frames per second, used by the rate control.
        folder: path of an empty folder for the encoded clip.

    Raises:
        DataError: there are no frames, or their sizes differ.
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
                        f"frame {number} differs in size from the first; all frames of a clip must be the same size"
                    )
                yield rgb_to_i420(frame)

        self._master = write_clip(folder / "master.mp4", pictures(), size, rate, lossless("veryfast"))

    def corrupted(self, corruption: str, parameter: int, wanted: range) -> tuple[list[Frame], bool]:
        """Corrupt the entire part and return some of its frames.

        Args:
            corruption: "h264_crf", "h264_abr" or "bit_error".
            parameter: CRF, bit/s, or N of the noise filter.
            wanted: indices of the frames, ascending.

        Returns:
            The frames, RGB uint8 (H, W, 3), and whether the stream was changed before the end of the last one;
            bit errors change nothing if the stream is too short for their rate.
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
