"""Open the user's videos and folders of images: accept only known containers, refuse cut files, decode strictly."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import av
import numpy as np
from av.sidedata.sidedata import Type as SideData
from av.video.reformatter import Interpolation

from ...core.errors import DataError
from ...core.types import Frame
from ...media.images import image_size, images_in, read_image

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


_LONGEST_NAME = 160
"""Maximum length of a clip's name, in bytes; the cache appends up to 60, and a file name may have 255."""


class Source(Protocol):
    """The frames of a clip, in order; they can be read repeatedly."""

    name: str
    count: int
    size: tuple[int, int]
    fps: Fraction | None
    """Frames per second; None if the source does not declare a rate (images)."""

    def frames(self) -> Iterator[Frame]:
        """Yield all frames, RGB uint8 (H, W, 3)."""

    def describe(self) -> dict[str, Any]:
        """Return a description of the source for the manifest."""


class PictureFolder:
    """A clip that consists of all images in a folder, in natural order."""

    fps: Fraction | None = None

    def __init__(self, folder: Path, name: str = "") -> None:
        self.folder = folder
        self.name = name or clip_name(folder.resolve().name)
        self.paths = images_in(folder)
        if not self.paths:
            raise DataError(folder, "contains no images; specify the folder with the frames of a clip")
        self.count = len(self.paths)
        self.size = image_size(self.paths[0])

    def frames(self) -> Iterator[Frame]:
        for path in self.paths:
            frame = read_image(path)
            if frame.shape[:2] != self.size:
                first = f"{self.size[0]}x{self.size[1]}"
                raise DataError(path, f"{frame.shape[0]}x{frame.shape[1]}, but the first image of the clip is {first}")
            yield frame

    def describe(self) -> dict[str, Any]:
        return {"kind": "pictures", "first": self.paths[0].name, "last": self.paths[-1].name}


class VideoFile:
    """The video stream of a file; audio is ignored, rotation is applied, and higher bit depths are reduced to 8
    bits.
    """

    def __init__(self, path: Path, evenly: bool = False) -> None:
        self.path = path
        self.name = clip_name(path.stem)
        with open_video(self.path) as container:
            stream = container.streams.video[0]
            rate, tick = stream.average_rate or stream.guessed_rate, stream.time_base
            self._pixels = stream.codec_context.pix_fmt or "unknown"
            self._codec = stream.codec_context.name
            times, _ = frame_times(container, path)
        self.count = len(times)
        self.fps = None if rate is None else Fraction(rate)
        self.variable = _variable(sorted(time for time in times if time is not None), tick)
        if self.variable and not evenly:
            low, high = self.variable
            gaps = f"{low * 1000:.1f} to {high * 1000:.1f} ms between frames"
            advice = f"convert it to a constant rate, or prepare it with --fps {float(self.fps or 30):.4g}"
            raise DataError(path, f"variable frame rate ({gaps}); {advice}")
        first = next(self.frames(), None)
        if first is None:
            raise DataError(path, "no frame can be decoded; is it a video?")
        self.size = (first.shape[0], first.shape[1])

    def frames(self) -> Iterator[Frame]:
        size: tuple[int, ...] | None = None
        read = 0
        with open_video(self.path) as container:
            stream = container.streams.video[0]
            try:
                for read, picture in enumerate(container.decode(stream), start=1):
                    if picture.is_corrupt:
                        raise DataError(self.path, f"frame {read - 1} is damaged; copy or convert it again")
                    frame = upright(picture, self.path)
                    size = size or frame.shape
                    if frame.shape != size:
                        raise DataError(self.path, f"the frame size changes at frame {read - 1}; split the file there")
                    yield frame
            except (av.error.FFmpegError, OSError) as error:
                raise DataError(self.path, f"damaged at frame {read} ({reason(error)}); convert it again") from error
        if read < self.count:
            raise DataError(self.path, f"{read} of {self.count} frames can be decoded; copy or convert it again")

    def describe(self) -> dict[str, Any]:
        return {
            "kind": "video",
            "file": self.path.name,
            "codec": self._codec,
            "pixels": self._pixels,
            "fps": None if self.fps is None else str(self.fps),
            "variable_rate": bool(self.variable),
        }


def clip_name(stem: str) -> str:
    r"""Return the name of a clip, which is also that of its folder, from the name of its file or folder without suffix.

    >>> clip_name(".walk"), clip_name("..."), clip_name("a\\b"), len(clip_name("x" * 250))
    ('walk', 'clip', 'a_b', 160)
    """
    name = stem.lstrip(".").replace("\\", "_")
    return name.encode(errors="ignore")[:_LONGEST_NAME].decode(errors="ignore") or "clip"


def _variable(times: list[int], tick: Fraction) -> tuple[float, float] | None:
    """Return the shortest and longest frame interval in seconds if they differ by more than tick rounding, else None.

    >>> _variable([0, 33, 67, 100, 133], Fraction(1, 1000)) is None
    True
    >>> _variable([0, 33, 67, 133], Fraction(1, 1000))
    (0.033, 0.066)
    """
    gaps = [later - earlier for earlier, later in pairwise(times)]
    if not gaps or max(gaps) - min(gaps) <= max(2, 0.02 * min(gaps)):
        return None
    return float(min(gaps) * tick), float(max(gaps) * tick)
