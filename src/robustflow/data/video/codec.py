"""Encode and decode H.264 with PyAV, and convert between RGB and YUV 4:2:0 in exact integer arithmetic, independent of
the version of any scaling library.

The colour space is 8-bit BT.601 with limited range, which FFmpeg assumes when it converts PNG files to H.264 and back;
this is how the published GoPro-FC was created. As in FFmpeg's unscaled converter, chroma is averaged over 2x2 pixels
when encoding and repeated when decoding. Frames are stored as I420: uint8 (H * 3 / 2, W) with the Y plane, followed by
U and V.

Encoder and decoder use one thread each, because the number of threads affects how damaged streams are decoded as well
as x264's rate control (ABR). Each packet carries the display index of its frame, so later steps do not have to count
frames.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np
import numpy.typing as npt
from av.codec.context import Flags

from ...core.compiled import njit
from ...core.errors import DataError, unknown_name
from ...core.types import Frame

I420 = npt.NDArray[np.uint8]
"""A YUV 4:2:0 frame, uint8 (H * 3 / 2, W); H and W are even."""


def even_size(height: int, width: int) -> tuple[int, int]:
    return height + height % 2, width + width % 2


def rgb_to_i420(frame: Frame) -> I420:
    """Convert RGB uint8 (H, W, 3) to I420 uint8; odd sizes are padded by repeating the last row or column."""
    height, width = frame.shape[:2]
    rows, columns = even_size(height, width)
    if (rows, columns) != (height, width):
        frame = np.pad(frame, ((0, rows - height), (0, columns - width), (0, 0)), mode="edge")
    out = np.empty((rows * 3 // 2, columns), np.uint8)
    chroma = out[rows:].reshape(2, rows // 2, columns // 2)
    _to_yuv(np.ascontiguousarray(frame), out[:rows], chroma[0], chroma[1])
    return out


def i420_to_rgb(picture: I420, height: int, width: int) -> Frame:
    """Convert I420 to RGB uint8 (height, width, 3), cropping off the padding of odd sizes."""
    rows, columns = even_size(height, width)
    if picture.shape != (rows * 3 // 2, columns):
        raise ValueError(f"I420 for {height}x{width} has the shape {(rows * 3 // 2, columns)}, not {picture.shape}")
    picture = np.ascontiguousarray(picture)
    chroma = picture[rows:].reshape(2, rows // 2, columns // 2)
    out = np.empty((height, width, 3), np.uint8)
    _to_rgb(picture[:rows], chroma[0], chroma[1], out)
    return out


@njit(cache=True, nogil=True)
def _to_yuv(rgb: Any, luma: Any, blue: Any, red: Any) -> None:
    # coefficients times 2**16; chroma is computed from the sum of four pixels, hence 2**18
    for i in range(blue.shape[0]):
        for j in range(blue.shape[1]):
            r_sum = 0
            g_sum = 0
            b_sum = 0
            for di in range(2):
                for dj in range(2):
                    pixel = rgb[2 * i + di, 2 * j + dj]
                    r, g, b = int(pixel[0]), int(pixel[1]), int(pixel[2])
                    luma[2 * i + di, 2 * j + dj] = 16 + ((16829 * r + 33039 * g + 6416 * b + 32768) >> 16)
                    r_sum += r
                    g_sum += g
                    b_sum += b
            blue[i, j] = 128 + ((-9714 * r_sum - 19071 * g_sum + 28785 * b_sum + 131072) >> 18)
            red[i, j] = 128 + ((28785 * r_sum - 24104 * g_sum - 4681 * b_sum + 131072) >> 18)


@njit(cache=True, nogil=True)
def _to_rgb(luma: Any, blue: Any, red: Any, rgb: Any) -> None:
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            y = 76309 * (int(luma[i, j]) - 16) + 32768
            u = int(blue[i >> 1, j >> 1]) - 128
            v = int(red[i >> 1, j >> 1]) - 128
            rgb[i, j, 0] = min(max((y + 104597 * v) >> 16, 0), 255)
            rgb[i, j, 1] = min(max((y - 25675 * u - 53279 * v) >> 16, 0), 255)
            rgb[i, j, 2] = min(max((y + 132201 * u) >> 16, 0), 255)


_LONGEST_SIDE = 16384
"""Largest width and height that x264 accepts, in pixels."""


@dataclass(frozen=True)
class Packet:
    """An encoded frame: its bytes and its display index in the clip."""

    data: bytes
    index: int


Options = dict[str, str]
"""Options of libx264."""


PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo",
)  # fmt: skip
"""The presets of x264, fastest first."""


def lossless(preset: str = "veryslow", every_frame: bool = False) -> Options:
    """Encode losslessly with CRF 0, as the reference code does for its master (with preset veryslow)."""
    if preset not in PRESETS:
        raise unknown_name("x264 preset", preset, PRESETS)
    return {"crf": "0", "preset": preset} | ({"g": "1"} if every_frame else {})


EXACT = {"x264-params": "asm=MMX2" if platform.machine().lower() in ("x86_64", "amd64") else "asm=0"}
"""Options for all lossy encodings, chosen so that the same frames result in the same stream on every machine.

x264's macroblock tree controls the quality of each part of a frame. Its AVX-512 code (as of x264 core 165) reads
uninitialised memory, so the stream differs between calls. The code for SSSE3 and later instruction sets rounds sums
differently from the C code, and SSE2 uses reciprocal instructions, whose results differ between processor vendors. With
MMX2, the tree is computed in C, and all other code uses exact integer arithmetic with any instruction set. Lossless
encoding does not use the tree, so it may use all instruction sets of the processor.
"""


def crf(value: int) -> Options:
    return {"crf": str(value)} | EXACT


def abr(rate: int) -> Options:
    """Encode at an average rate, in bits per second."""
    return dict.fromkeys(("b", "maxrate", "bufsize"), str(rate)) | EXACT


def check_size(height: int, width: int) -> None:
    if max(height, width) > _LONGEST_SIDE:
        raise DataError(f"frames of {width}x{height}", f"H.264 encodes at most {_LONGEST_SIDE} pixels per side")


def configure(context: Any, height: int, width: int, fps: Fraction, options: Options) -> None:
    """Set up an encoder context; `height` and `width` are even. Raises the errors of `check_size`."""
    check_size(height, width)
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.framerate, context.time_base = fps, 1 / fps
    context.thread_count, context.thread_type = 1, "NONE"
    context.flags |= Flags.global_header  # as in MP4 files; otherwise, rate control would count the header
    context.options = options


def video_frame(picture: I420, index: int, fps: Fraction) -> Any:
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="yuv420p")
    frame.pts, frame.time_base = index, 1 / fps
    return frame


class Encoder:
    """Encodes the I420 frames of one clip as a stream of packets, in coded order."""

    def __init__(self, height: int, width: int, fps: Fraction, options: Options) -> None:
        self._context: Any = av.CodecContext.create("libx264", "w")
        self._fps = fps
        configure(self._context, height, width, fps, options)
        self._context.open()
        self.header = bytes(self._context.extradata or b"")

    def encode(self, pictures: Iterable[tuple[int, I420]]) -> Iterator[Packet]:
        for index, picture in pictures:
            for packet in self._context.encode(video_frame(picture, index, self._fps)):
                yield self._packet(packet)
        for packet in self._context.encode(None):
            yield self._packet(packet)

    def _packet(self, packet: Any) -> Packet:
        return Packet(bytes(packet), int(packet.pts * packet.time_base * self._fps))


class Decoder:
    """Decodes the packets of one clip to (display index, frame) pairs, in the output order of the decoder."""

    def __init__(self, header: bytes, height: int, width: int) -> None:
        self._context: Any = av.CodecContext.create("h264", "r")
        self._context.extradata = header
        self._context.thread_count, self._context.thread_type = 1, "NONE"
        self._size = (height, width)
        self.refused_packets = 0
        self.strange_pictures = 0  # without presentation time, or not of the clip's size or format; they count as lost

    def decode(self, packets: Iterable[Packet]) -> Iterator[tuple[int, I420]]:
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
            self.refused_packets += 1
            return
        for frame in frames:
            is_420 = frame.format.name in ("yuv420p", "yuvj420p")
            if (frame.height, frame.width) != self._size or frame.pts is None or not is_420:
                self.strange_pictures += 1
            else:
                yield frame.pts, frame.to_ndarray()


def encoder_versions() -> dict[str, str]:
    """Return the library versions that affect the codec's output, for manifests."""
    grey = np.full((24, 16), 128, np.uint8)
    stream = b"".join(p.data for p in Encoder(16, 16, Fraction(25), lossless("ultrafast")).encode([(0, grey)]))
    start = stream.find(b"x264 - core")
    x264 = stream[start : stream.find(b" - H.264", start)].decode("ascii", "replace") if start >= 0 else "unknown"
    libavcodec = ".".join(str(part) for part in av.library_versions["libavcodec"])
    return {"pyav": av.__version__, "libavcodec": libavcodec, "libx264": x264.removeprefix("x264 - ")}
