"""Open user video files safely: accept only known containers, check the declared length, and decode strictly."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

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

_CUT = "copy or download it again"


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
        check_stated_length(path, container.format.name)
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


def check_stated_length(path: Path, kind: str) -> None:
    """Check that the length of a file equals the length declared by its container, if any."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        if "matroska" in kind:
            _check_matroska(path, file, size)
        elif kind == "avi":
            _check_avi(path, file, size)
        elif kind == "mpegts":
            _check_transport_stream(path, file, size)


def reason(error: BaseException) -> str:
    """Return the reason for an error from FFmpeg or the operating system, as a single line."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return str(text).splitlines()[0]


def _check_matroska(path: Path, file: BinaryIO, size: int) -> None:
    """Check that the top-level elements (EBML header, segments) fill the file."""
    position = 0
    for identity, start, length in _elements(file, size):
        if length is None:
            return  # a live recording, which does not declare its length
        if identity not in _TOP:
            break
        position = start + length
    if position != size:
        state = "cut short" if position > size else "damaged"
        raise DataError(path, f"{state}: the file has {size} bytes, but its segments declare {position}; {_CUT}")


_TOP = (0x1A45DFA3, 0x18538067, 0xEC, 0xBF)
"""Element IDs: EBML header, segment, void, checksum."""


def _elements(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int | None]]:
    position = 0
    while position < size:
        file.seek(position)
        head = file.read(16)
        width = 9 - head[0].bit_length() if head else 9
        if width > 4 or len(head) <= width:
            yield -1, position, 0
            return
        identity, head = int.from_bytes(head[:width], "big"), head[width:]
        digits = 9 - head[0].bit_length()
        if digits > 8 or len(head) < digits:
            yield -1, position, 0
            return
        length = int.from_bytes(head[:digits], "big") - (1 << 7 * digits)
        unknown = length == (1 << 7 * digits) - 1
        yield identity, position + width + digits, None if unknown else length
        if unknown:
            return
        position += width + digits + length


def _check_avi(path: Path, file: BinaryIO, size: int) -> None:
    """Check that the RIFF chunks (several in files larger than 1 GB) fill the file."""
    position = 0
    while position < size:
        file.seek(position)
        head = file.read(8)
        if head[:4] not in (b"RIFF", b"JUNK") or len(head) < 8:
            raise DataError(path, f"damaged: {size - position} unexpected bytes at the end; {_CUT}")
        length = int.from_bytes(head[4:], "little")
        position += 8 + length + length % 2
    if position - size not in (0, 1):
        raise DataError(path, f"cut short: the file has {size} bytes, but its header declares {position}; {_CUT}")


def _check_transport_stream(path: Path, file: BinaryIO, size: int) -> None:
    """Check that packets of equal length fill the file."""
    start = file.read(1024)
    for length, first in ((188, 0), (192, 4), (204, 0)):
        if all(start[place : place + 1] in (b"G", b"") for place in range(first, 1024, length)):
            if size % length:
                raise DataError(path, f"cut short or damaged: the last packet is incomplete; {_CUT}")
            file.seek(max(0, size - 256 * length))
            tail = file.read()
            if all(tail[place] == ord("G") for place in range(first, len(tail), length)):
                return
            break
    raise DataError(path, f"damaged: the packets are not contiguous; {_CUT}")
