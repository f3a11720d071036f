"""H.264 through PyAV: encode pictures to packets, decode packets to pictures by presentation time.

One thread on both sides. Two decoder threads give different pictures on damaged streams, and x264's rate control
(ABR) depends on its thread count. A packet carries the display index of its picture, so nothing downstream has to count
pictures.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np
from av.codec.context import Flags

from ..errors import UsageError, unknown_name
from .colour import I420


@dataclass(frozen=True)
class Packet:
    """One coded picture: its bytes, and the display index of the picture in the clip."""

    data: bytes
    index: int


@dataclass(frozen=True)
class Encoding:
    """How to encode: a name for records, and libx264's options."""

    name: str
    options: tuple[tuple[str, str], ...]


PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo",
)  # fmt: skip
"""x264's presets, fastest first."""


def lossless(preset: str = "veryslow", every_frame: bool = False) -> Encoding:
    """CRF 0, as the reference makes its master (whose preset is veryslow). `every_frame`: no picture needs another."""
    if preset not in PRESETS:
        raise unknown_name("x264 preset", preset, PRESETS)
    options = [("crf", "0"), ("preset", preset)]
    if every_frame:
        options += [("g", "1")]
    return Encoding("lossless", tuple(options))


EXACT = (("x264-params", "asm=MMX2" if platform.machine().lower() in ("x86_64", "amd64") else "asm=0"),)
"""Options of every lossy encoding, so that equal pictures make equal streams on every machine.

x264's macroblock tree decides how good each part of a picture must be. Its AVX-512 code (core 165) reads memory that
was never written, so the stream differs from call to call; SSSE3 and later round its sums differently from the C code,
and SSE2 uses reciprocals that differ between makers of processors. With MMX2 the tree runs in C, and the rest is
integer arithmetic that is exact at any level. Lossless encoding has no such tree and may use whatever the processor
offers.
"""


def crf(value: int) -> Encoding:
    """Constant rate factor, 0 (lossless) to 51, preset medium, as the reference's call without a preset."""
    if not 0 <= value <= 51:
        raise UsageError(f"a CRF of {value} does not exist: choose 0 (lossless) to 51")
    return Encoding(f"crf_{value}", (("crf", str(value)), *EXACT))


def abr(rate: int) -> Encoding:
    """Average bit rate in bit/s, with maxrate = bufsize = rate as in the reference code."""
    if rate <= 0:
        raise UsageError(f"the bit rate cannot be {rate}: give bits per second")
    return Encoding(f"abr_{rate}", (("b", str(rate)), ("maxrate", str(rate)), ("bufsize", str(rate)), *EXACT))


def configure(context: Any, height: int, width: int, fps: Fraction, encoding: Encoding) -> None:
    """Set an encoder context up; `height` and `width` are even."""
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.framerate, context.time_base = fps, 1 / fps
    context.thread_count, context.thread_type = 1, "NONE"
    context.flags |= Flags.global_header  # as in an MP4 file; otherwise the header counts in the rate control
    context.options = dict(encoding.options)


def video_frame(picture: I420, index: int, fps: Fraction) -> Any:
    """The PyAV frame of an I420 picture."""
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="yuv420p")
    frame.pts, frame.time_base = index, 1 / fps
    return frame


class Encoder:
    """Streams I420 pictures of one clip into packets, in coded order.

    Args:
        height, width: of the pictures, both even.
        fps: frames per second; rate control needs it.

    `header` holds the parameter sets that a decoder needs.
    """

    def __init__(self, height: int, width: int, fps: Fraction, encoding: Encoding) -> None:
        self._context: Any = av.CodecContext.create("libx264", "w")
        self._fps = fps
        configure(self._context, height, width, fps, encoding)
        self._context.open()
        self.header = bytes(self._context.extradata or b"")

    def encode(self, pictures: Iterable[tuple[int, I420]]) -> Iterator[Packet]:
        """Packets of (index, picture) pairs given in display order."""
        for index, picture in pictures:
            for packet in self._context.encode(video_frame(picture, index, self._fps)):
                yield self._packet(packet)
        for packet in self._context.encode(None):
            yield self._packet(packet)

    def _packet(self, packet: Any) -> Packet:
        return Packet(bytes(packet), int(packet.pts * packet.time_base * self._fps))


@dataclass
class DecodeLog:
    """What a decoder found in a damaged stream."""

    refused_packets: int = 0
    strange_pictures: int = 0
    """Pictures without a time, or whose size or format differs from the clip's; they count as lost."""


class Decoder:
    """Streams packets of one clip into (display index, picture) pairs, in the order the decoder releases them.

    A packet that cannot be decoded is counted in `log` and skipped, as the reference's ffmpeg does. The output is
    that of FFmpeg's decoder with one thread and its default error concealment.
    """

    def __init__(self, header: bytes, height: int, width: int) -> None:
        self._context: Any = av.CodecContext.create("h264", "r")
        self._context.extradata = header
        self._context.thread_count, self._context.thread_type = 1, "NONE"
        self._size = (height, width)
        self.log = DecodeLog()

    def decode(self, packets: Iterable[Packet]) -> Iterator[tuple[int, I420]]:
        """Pictures as I420 uint8 (H * 3 / 2, W)."""
        for packet in packets:
            if not packet.data:
                continue  # an empty packet would end the stream
            coded = av.Packet(packet.data)
            coded.pts = packet.index
            yield from self._pictures(coded)
        yield from self._pictures(None)

    def _pictures(self, coded: Any) -> Iterator[tuple[int, I420]]:
        try:
            frames = self._context.decode(coded)
        except av.error.FFmpegError:
            self.log.refused_packets += 1
            return
        for frame in frames:
            if (frame.height, frame.width) != self._size or frame.pts is None or not _is_420(frame):
                self.log.strange_pictures += 1
            else:
                yield frame.pts, frame.to_ndarray()


def _is_420(frame: Any) -> bool:
    return frame.format.name in ("yuv420p", "yuvj420p")


def encoder_versions() -> dict[str, str]:
    """The versions that decide what the codec does, for manifests.

    >>> sorted(encoder_versions())
    ['libavcodec', 'libx264', 'pyav']
    """
    grey = np.full((24, 16), 128, np.uint8)
    stream = b"".join(p.data for p in Encoder(16, 16, Fraction(25), lossless("ultrafast")).encode([(0, grey)]))
    start = stream.find(b"x264 - core")
    x264 = stream[start : stream.find(b" - H.264", start)].decode("ascii", "replace") if start >= 0 else "unknown"
    libavcodec = ".".join(str(part) for part in av.library_versions["libavcodec"])
    return {"pyav": av.__version__, "libavcodec": libavcodec, "libx264": x264.removeprefix("x264 - ")}
