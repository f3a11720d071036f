"""Open a video: accept known containers, choose the stream, list its packets, refuse damaged or cut files."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.stream import Disposition

from ...core.errors import DataError

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,h264,hevc,yuv4mpegpipe,gif"
"""Allowed demuxers; playlists are excluded because they can refer to other files or URLs."""

STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
"""Decoder options that raise an error if data cannot be decoded, instead of concealing the damage. A single thread is
used because with several threads, the H.264 decoder does not report the error.
"""

_SAME_DCT = {"idct": "simple"}
"""Decoder option that selects the same inverse DCT on every processor (for MPEG-1, MPEG-2, H.263 and Motion JPEG)."""


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
        context = main_stream(container, path).codec_context
        context.thread_count, context.thread_type = 1, "NONE"
        context.options = STRICT | _SAME_DCT
    except BaseException:
        container.close()
        raise
    return container


def main_stream(container: Any, path: Path) -> Any:
    """Return the video stream with the largest frames; others are previews. Cover pictures are no videos."""
    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    if not streams:
        raise DataError(path, "has no video stream; check the file")
    if any(stream.codec_context is None for stream in streams):
        raise DataError(path, "not a readable video (its codec is unknown); check or convert the file")
    sizes = [stream.codec_context.width * stream.codec_context.height for stream in streams]
    first, *others = (stream for stream, size in zip(streams, sizes, strict=True) if size == max(sizes))
    if others:
        raise DataError(path, f"has {1 + len(others)} videos of the same size; save each as a separate file")
    if first.metadata.get("alpha_mode") == "1":  # the decoder ignores it
        raise transparent(path)
    return first


def transparent(path: Path) -> DataError:
    return DataError(path, "the video has transparent pixels; flatten it onto a background first")


def frame_times(container: Any, path: Path) -> tuple[list[int | None], list[int | None]]:
    """Return the presentation times of the displayed frames in file order, and those of the key frames, without
    decoding; refuse a file that holds less than it states, or whose container is damaged."""
    stream = main_stream(container, path)
    times: list[int | None] = []
    keys: list[int | None] = []
    packets, end, frame, last = 0, Fraction(0), 1 / Fraction(stream.average_rate or 30), 0
    damaged = False
    try:
        with _demuxer_errors() as messages:
            for packet in container.demux():
                damaged |= packet.is_corrupt
                last = max(last, (packet.pos or 0) + packet.size)
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
        length = next((length for length in (188, 192, 204) if size % length == 0), 0)
        cut = not length
        damaged |= not cut and not _in_step(path, length)
    elif kind == "matroska,webm":  # FFmpeg reads on after damage, and only logs it
        cut = end + frame / 2 < Fraction(container.duration or 0, av.time_base)
        damaged |= any(name == kind for _, name, _ in messages)
    elif kind == "gif":
        cut = _images_of_gif(path.read_bytes()) != packets
    else:
        cut = kind == "yuv4mpegpipe" and last != size
    if damaged:
        raise DataError(path, "damaged: some of its packets are lost; copy or convert it again")
    if cut:
        raise DataError(path, "cut short: it holds fewer frames than it states; copy or download it again")
    return times, keys


def _in_step(path: Path, length: int) -> bool:
    """Return whether each packet of a transport stream begins with its mark."""
    return bool((np.memmap(path, np.uint8, "r")[4 * (length == 192) :: length] == 0x47).all())


def _images_of_gif(data: bytes) -> int:
    """Return the number of images of a GIF file; -1 if it does not end after a block."""
    at, images = 13 + (6 << (data[10] & 7) if data[10] & 128 else 0), 0
    while at < len(data) and data[at] in (0x21, 0x2C):
        if data[at] == 0x21:  # an extension
            at += 2
        else:
            images += 1
            colours = data[at + 9 : at + 10] or b"\0"
            at += 11 + (6 << (colours[0] & 7) if colours[0] & 128 else 0)
        while at < len(data) and data[at]:
            at += 1 + data[at]
        at += 1
    return images if data[at:].rstrip(b"\0") == b";" else -1


_logging = threading.Lock()


@contextmanager
def _demuxer_errors() -> Iterator[list[tuple[int, str, str]]]:
    """Collect the errors that FFmpeg logs in this thread: level, name of the demuxer, message."""
    with _logging, av.logging.Capture() as messages:
        level = av.logging.get_level()
        av.logging.set_level(av.logging.ERROR)
        try:
            yield messages
        finally:
            av.logging.set_level(level)


def reason(error: BaseException) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return str(text).splitlines()[0]
