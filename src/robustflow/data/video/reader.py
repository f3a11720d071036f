"""Read the user's videos by frame number, decoding strictly.

Nearby frames are reached by decoding forward, distant ones by seeking to a key frame. The list of frames is read from
the container's packets, without decoding, and checked by decoding the first frame and all frames after the last key
frame. If the check fails (missing or repeated time stamps, two packets per frame), the entire file is decoded once to
count the frames.
"""

from __future__ import annotations

import os
import warnings
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.sidedata.sidedata import Type as SideData
from av.video.reformatter import Interpolation

from ...core.errors import DataError
from ...core.types import Frame
from .container import frame_times, main_stream, open_video, reason, transparent

_HDR = {16: "PQ (SMPTE ST 2084)", 18: "HLG (ARIB STD-B67)"}
"""Transfer functions by their number in ITU-T H.273."""

_EXACT_RGB = (
    Interpolation.BILINEAR
    | Interpolation.ACCURATE_RND
    | Interpolation.BITEXACT
    | Interpolation.FULL_CHR_H_INT
    | Interpolation.FULL_CHR_H_INP
)
"""Flags of FFmpeg's conversion to RGB. By default, FFmpeg rounds down, by one grey level on average, and differently on
different processors.
"""


def upright(picture: Any, path: Path) -> Frame:
    """Convert a decoded frame to RGB uint8 (H, W, 3), rotated and mirrored as in video players: phones store a display
    matrix instead of turning the frames.
    """
    quarter, rest = divmod(int(picture.rotation), 90)
    if rest:
        raise DataError(path, f"rotated by {picture.rotation} degrees; only multiples of 90 degrees are supported")
    has_alpha = any(component.is_alpha for component in picture.format.components)
    if has_alpha and (picture.to_ndarray(format="rgba")[..., 3] < 255).any():
        raise transparent(path)
    frame = picture.to_ndarray(format="rgb24", interpolation=_EXACT_RGB)
    if _is_mirrored(picture):
        frame, quarter = frame[:, ::-1], quarter + 2  # FFmpeg's angle is that of the mirrored horizontal axis
    return np.ascontiguousarray(np.rot90(frame, quarter % 4))


def _is_mirrored(picture: Any) -> bool:
    matrix = picture.side_data.get(SideData.DISPLAYMATRIX)
    if matrix is None:
        return False
    a, b, _, c, d, *_ = np.frombuffer(bytes(matrix), np.int32).tolist()
    return bool(a * d < b * c)


_NEAR = 48
"""Maximum distance in frames for which decoding forward is preferred to seeking."""

_KEYS_BACK = 2
"""Number of earlier key frames to try if decoding cannot start at the nearest one (an open group of pictures)."""


class VideoReader:
    """Random access to the frames of a file's first video stream, rotated as specified by its metadata.

    Attributes:
        rate: frames per second, None if unknown.
        times: known presentation times of the frames, ascending, in units of `tick` seconds.
        codec: name of the codec.
        pixels: name of the pixel format.
        transfer: name of the transfer function if it is one of HDR, which is not converted.
    """

    rate: Fraction | None
    times: list[int]
    tick: Fraction
    codec: str
    pixels: str
    transfer: str | None

    _container: Any
    _stream: Any
    _frames: Iterator[Any] | None
    _image: Frame | None
    _position: int
    _pid: int

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._close()
        self._stamps: list[int] = []
        self._key_stamps: list[int] = []
        self._count = 0
        self._call(self._index)
        if self.transfer is not None:
            why = f"HDR with transfer function {self.transfer}; its values are measured as if they were those of SDR"
            warnings.warn(f"{self._path}: {why}", stacklevel=2)

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int) -> Frame:
        if not 0 <= index < self._count:
            raise IndexError(f"{self._path} has frames 0 to {self._count - 1}, but no frame {index}")
        if self._pid != os.getpid():
            self._close()
        if self._image is None or index != self._position:
            self._image = self._call(self._decode, index)
        return self._image.copy()

    def index_at(self, seconds: float) -> int:
        """Return the index of the first frame displayed at or after a time."""
        if not self._stamps:
            raise DataError(self._path, "its frames have no usable time stamps; use frame numbers, not seconds")
        return bisect_left(self._stamps, self._stamps[0] + round(seconds / self.tick))

    def __getstate__(self) -> dict[str, Any]:
        transient = {"_container": None, "_stream": None, "_frames": None, "_image": None, "_position": -1, "_pid": -1}
        return {**self.__dict__, **transient}

    def _close(self) -> None:
        self._container = self._stream = None
        self._frames = None
        self._position = -1
        self._image = None
        self._pid = os.getpid()

    def _call(self, step: Any, *arguments: Any) -> Any:
        try:
            return step(*arguments)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._close()
            why = reason(error)
            raise DataError(self._path, f"not a readable video ({why}); check or convert the file") from error

    def _open(self) -> None:
        self._close()
        self._container = open_video(self._path)
        self._stream = main_stream(self._container, self._path)
        self._frames = iter(self._container.decode(self._stream))

    def _index(self) -> None:
        with open_video(self._path) as container:
            stream = main_stream(container, self._path)
            rate = stream.average_rate or stream.guessed_rate
            self.rate, self.tick = None if rate is None else Fraction(rate), stream.time_base or Fraction(1)
            self.transfer = _HDR.get(stream.codec_context.color_trc)
            self.codec, self.pixels = stream.codec_context.name, stream.codec_context.pix_fmt or "unknown"
            times, keys = frame_times(container, self._path)
        self.times = sorted(time for time in times if time is not None)
        if len(set(self.times)) == len(times) and keys:
            self._stamps, self._key_stamps = self.times, sorted(key for key in keys if key is not None)
            self._count = len(times)
            if self._holds():
                return
        self._stamps = self._key_stamps = []
        self._open()
        self._count = sum(1 for _ in self._frames or ())
        self._close()
        if not self._count:
            raise ValueError("no frame can be decoded")

    def _holds(self) -> bool:
        """Return whether the packets match the decoded first frame and the decoded end of the video."""
        try:
            self._open()
            first = next(self._frames or iter(()), None)
            tail = self._tail()
        except av.error.FFmpegError:
            return False
        finally:
            self._close()
        expected = [stamp for stamp in self._stamps if stamp >= self._key_stamps[-1]]
        return first is not None and first.pts == self._stamps[0] and tail == expected

    def _tail(self) -> list[int]:
        """Return the time stamps of the frames decoded after the last key frame; -1 for frames without a time stamp."""
        stamps: list[int] = []
        for key in self._key_stamps[-1 : -1 - _KEYS_BACK : -1]:
            self._container.seek(key, stream=self._stream)
            try:
                stamps = [-1 if frame.pts is None else frame.pts for frame in self._container.decode(self._stream)]
                break
            except av.error.FFmpegError:  # frames displayed before the key frame depend on frames stored before it
                self._open()
        return [stamp for stamp in stamps if stamp >= self._key_stamps[-1]]

    def _decode(self, index: int) -> Frame:
        forward = self._frames is not None and self._position < index
        if not forward or (self._stamps and index - self._position > _NEAR):
            for back in range(_KEYS_BACK):
                try:
                    self._start(index, back)
                    return self._advance(index)
                except (
                    av.error.FFmpegError
                ):  # as in `_tail`; if every attempt fails, start at the beginning of the file
                    self._close()
            self._open()
        return self._advance(index)

    def _advance(self, index: int) -> Frame:
        for frame in self._frames or ():
            number = self._number(frame)
            self._position = number
            if number == index:
                if frame.is_corrupt:
                    raise ValueError(f"frame {index} is damaged")
                return upright(frame, self._path)
            if number > index:
                break
        raise ValueError(f"frame {index} cannot be decoded")

    def _start(self, index: int, back: int) -> None:
        """Open the file; if possible, seek to `back` key frames before the one needed for frame `index`."""
        if self._container is None:
            self._open()
        place = bisect_right(self._key_stamps, self._stamps[index]) - 1 - back if self._stamps else -1
        if place < 0:
            self._open()
            return
        self._container.seek(self._key_stamps[place], stream=self._stream)
        self._frames = iter(self._container.decode(self._stream))
        first = next(self._frames, None)
        if first is None or first.pts > self._stamps[index]:  # the container's index pointed to a later frame
            self._open()
        else:
            self._frames = chain([first], self._frames)
        self._position = -1

    def _number(self, frame: Any) -> int:
        if not self._stamps:
            return self._position + 1
        return bisect_right(self._stamps, frame.pts) - 1
