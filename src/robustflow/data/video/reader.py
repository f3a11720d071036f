"""Read the user's videos by frame number: accept only known containers, refuse cut files, decode strictly.

Nearby frames are reached by decoding forward, distant ones by seeking to a key frame. The list of frames is read from
the container's packets, without decoding, and checked by decoding the first frame and all frames after the last key
frame. If the check fails (missing or repeated time stamps, two packets per frame), the entire file is decoded once to
count the frames.
"""

from __future__ import annotations

import os
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

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,h264,hevc,yuv4mpegpipe,gif"
"""Allowed demuxers; playlists are excluded because they can refer to other files or URLs."""

STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
"""Decoder options that raise an error if data cannot be decoded, instead of concealing the damage. A single thread is
used because with several threads, the H.264 decoder does not report the error.
"""

_SAME_DCT = {"idct": "simple"}
"""Decoder option that selects the same inverse DCT on every processor (for MPEG-1, MPEG-2, H.263 and Motion JPEG)."""

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


def open_video(path: Path) -> Any:
    """Open a container with its video stream set to strict decoding in one thread."""
    if not path.is_file():
        raise DataError(path, "no such file; check the path")
    try:
        options = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
        container = av.open(str(path.absolute()), options=options)
    except av.error.ArgumentError as error:  # the container is not in the list
        raise DataError(path, "not a readable video (an unsupported container); convert it to .mp4") from error
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise DataError(path, f"not a readable video ({reason(error)}); check or convert the file") from error
    try:
        if not container.streams.video:
            raise DataError(path, "has no video stream; check the file")
        context = container.streams.video[0].codec_context
        if context is None:
            raise DataError(path, "not a readable video (its codec is unknown); check or convert the file")
        context.thread_count, context.thread_type = 1, "NONE"
        context.options = STRICT | _SAME_DCT
    except BaseException:
        container.close()
        raise
    return container


def upright(picture: Any, path: Path) -> Frame:
    """Convert a decoded frame to RGB uint8 (H, W, 3), rotated and mirrored as in video players: phones store a display
    matrix instead of turning the frames.
    """
    quarter, rest = divmod(int(picture.rotation), 90)
    if rest:
        raise DataError(path, f"rotated by {picture.rotation} degrees; only multiples of 90 degrees are supported")
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


def frame_times(container: Any, path: Path) -> tuple[list[int | None], list[int | None]]:
    """Return the presentation times of the displayed frames in file order, and those of the key frames, without
    decoding; refuse a file that holds less than it states."""
    stream = container.streams.video[0]
    times: list[int | None] = []
    keys: list[int | None] = []
    packets, end, frame = 0, Fraction(0), 1 / Fraction(stream.average_rate or 30)
    try:
        for packet in container.demux():
            if packet.pts is not None and packet.size:
                length = packet.duration * packet.time_base if packet.duration else frame
                end = max(end, packet.pts * packet.time_base + length)
            if packet.stream_index == stream.index and (packet.size or packet.dts is not None):
                packets += 1
                if packet.size and not packet.is_discard:
                    times.append(packet.pts)
                    if packet.is_keyframe:
                        keys.append(packet.pts)
    except (av.error.FFmpegError, OSError) as error:
        raise DataError(path, f"damaged ({reason(error)}); copy or convert it again") from error
    kind, size = container.format.name, path.stat().st_size
    if "mp4" in kind or kind == "avi":
        cut = packets < stream.frames
    elif kind == "mpegts":  # packets of one length; a file cut between two of them cannot be told from a shorter one
        cut = all(size % length for length in (188, 192, 204))
    else:
        stated = Fraction(container.duration or 0, av.time_base) if kind == "matroska,webm" else 0
        cut = end + frame / 2 < stated
    if cut:
        raise DataError(path, "cut short: it holds fewer frames than it states; copy or download it again")
    return times, keys


def reason(error: BaseException) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return str(text).splitlines()[0]


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
    """

    rate: Fraction | None
    times: list[int]
    tick: Fraction
    codec: str
    pixels: str

    _container: Any
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
        transient = {"_container": None, "_frames": None, "_image": None, "_position": -1, "_pid": -1}
        return {**self.__dict__, **transient}

    def _close(self) -> None:
        self._container = None
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
        self._frames = iter(self._container.decode(video=0))

    def _index(self) -> None:
        with open_video(self._path) as container:
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            self.rate, self.tick = None if rate is None else Fraction(rate), stream.time_base or Fraction(1)
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
            self._container.seek(key, stream=self._container.streams.video[0])
            try:
                stamps = [-1 if frame.pts is None else frame.pts for frame in self._container.decode(video=0)]
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
        self._container.seek(self._key_stamps[place], stream=self._container.streams.video[0])
        self._frames = iter(self._container.decode(video=0))
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
