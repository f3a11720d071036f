"""Open user video files safely: accept only known containers, refuse cut files, and decode strictly."""

from __future__ import annotations

from fractions import Fraction
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
