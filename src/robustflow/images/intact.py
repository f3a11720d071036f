"""Detect damage in image files that decoders ignore, as far as the file format allows.

PNG and deflated TIFF files contain checksums, damage to a JPEG usually breaks its entropy coding, and BMP, PPM and WebP
headers imply or state the file size. Other damage only changes pixel values and cannot be detected, so a run's manifest
stores a hash of every file.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import DataError

_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
MOST_INFLATED = 1100
"""Deflate cannot compress data by more than 1032:1, so a file that claims a higher ratio is damaged."""

LARGEST = 2**30
"""Maximum size of an image file in bytes; the largest supported image needs half as much."""


class PngHeader(NamedTuple):
    """A PNG header: image size, bits per channel, and number of channels (a palette counts as one)."""

    width: int
    height: int
    bits: int
    channels: int


def check_png(path: Path, data: bytes) -> PngHeader:
    """Read a PNG header and check, without decoding, that all chunks are present and undamaged."""
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR" or len(data) < 33:
        raise DataError(f"{path}: not a PNG file, or truncated; check or copy it again")
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    header = PngHeader(width, height, bits, _PNG_CHANNELS.get(kind, 0))
    if width * height * bits * header.channels > 8 * MOST_INFLATED * len(data):
        raise DataError(
            f"{path}: damaged: {len(data)} bytes are too few for {height}x{width} pixels; copy or download it again"
        )
    view, start, name = memoryview(data), 8, b""
    while name != b"IEND":
        length = int.from_bytes(view[start : start + 4], "big")
        end = start + 12 + length
        if end > len(data):
            raise DataError(f"{path}: truncated, the end of the PNG is missing; copy or download it again")
        name = data[start + 4 : start + 8]
        # Pillow stops reading after the last row, before it reaches the checksum of the last chunk.
        if zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise DataError(f"{path}: damaged, a checksum of the PNG is wrong; copy or download it again")
        start = end
    return header


def check_png_rows(path: Path, data: bytes, pixels: np.ndarray[Any, Any], interlaced: bool) -> None:
    """Reject a PNG whose compressed data ends before the last row; Pillow would fill the missing rows with zeros, while
    libpng, which OpenCV uses, does not decode it.
    """
    import cv2

    suspect = interlaced or not pixels[-1:].any()
    if suspect and cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is None:
        raise DataError(f"{path}: damaged, the PNG ends before its last row; copy or download it again")


def check_jpeg(path: Path, data: bytes) -> None:
    """Reject a JPEG with broken entropy coding; Pillow's decoder would silently continue with grey or shifted
    blocks.
    """
    import av

    context = av.CodecContext.create("mjpeg", "r")
    context.thread_count = 1
    context.options = {"err_detect": "crccheck+bitstream+buffer+careful+compliant+aggressive+explode"}
    try:
        frames: list[Any] = [*context.decode(av.Packet(data)), *context.decode(None)]
    except av.error.PatchWelcomeError:
        return
    except (av.error.FFmpegError, ValueError) as error:
        raise DataError(f"{path}: damaged, the JPEG data is corrupt; copy it again") from error
    if not frames or any(frame.is_corrupt for frame in frames):
        raise DataError(f"{path}: damaged, the JPEG data is corrupt; copy it again")


def check_length(path: Path, data: bytes, kind: str | None, end: int = 0) -> None:
    """Reject a file that is longer or shorter than its header implies."""
    sizes: tuple[int, ...] = ()
    if kind == "WEBP":
        size = int.from_bytes(data[4:8], "little")
        sizes = (8 + size, 8 + size + size % 2)
    elif kind == "BMP":
        sizes = (int.from_bytes(data[2:6], "little") or len(data),)
    elif kind == "PPM" and end and data[end:].strip():
        sizes = (end,)
    if sizes and len(data) not in sizes:
        state = "truncated" if len(data) < sizes[0] else "too long, or contains several images"
        raise DataError(
            f"{path}: {state}: {len(data)} bytes, but the header implies {sizes[0]}; copy or convert it again"
        )


def check_deflated_strips(path: Path, data: bytes, offsets: Any, counts: Any) -> None:
    """Reject a deflated TIFF with a wrong strip checksum, which libtiff does not verify."""
    for offset, count in zip(offsets or (), counts or (), strict=False):
        inflate, part = zlib.decompressobj(), memoryview(data)[offset : offset + count].tobytes()
        try:
            while not inflate.eof:
                out = inflate.decompress(part, 2**20)
                part = inflate.unconsumed_tail
                if not out and not part:
                    raise DataError(f"{path}: damaged, a strip of the TIFF is truncated; copy it again")
        except zlib.error as error:
            raise DataError(f"{path}: damaged, a checksum of the TIFF is wrong; copy it again") from error
