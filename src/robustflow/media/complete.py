"""Let decoders notice that a picture's data do not fill the size in its header; otherwise they leave pixels grey or
black.

The end of the data is withheld from the decoder, which then asks for more unless it already has all pixels. For a JPEG
of one scan, eight bytes that continue no common code stand for the end, because libjpeg reads ahead; a loss of a few
bytes within the last block of pixels can pass. A JPEG of several scans is decoded twice, with other bytes after each
scan: they change pixels only if a scan is too short.
"""

from __future__ import annotations

import io
import os
import re
import struct
import threading
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import BinaryIO

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"

_MOST_PIXELS = 512
"""Pixels per byte that a JPEG can hold: each block of 8x8 takes at least one bit."""

_READ_AHEAD = b"\xfe" * 8
_OTHER_BYTES = bytes(range(1, 255)) * 4

_MARKER = re.compile(rb"\xff+([^\x00\xff])")
_MARKER_EXCEPT_RESTARTS = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])")
_SOF, _LAST_SOF, _EOI, _SOS, _DRI = 0xC0, 0xCF, 0xD9, 0xDA, 0xDD
_NO_SOF = (0xC4, 0xC8, 0xCC)
_STANDALONE = (0x01, *range(0xD0, 0xD8))


def without_end(data: bytes) -> tuple[bytes, bytes]:
    """Return the data of a picture without their end, and, for a JPEG of several scans, the other variant of the data,
    otherwise nothing. Raise a ValueError if the data are too short."""
    if data.startswith(PNG):
        return _png_without_end(data), b""
    return _jpeg_without_end(data) if data.startswith(JPEG) else (data, b"")


def png_chunks(file: BinaryIO, pixels: bool = True) -> Iterator[tuple[bytes, bytes]]:
    """Yield the kind and the content of each chunk of a PNG file, with or without those of pixels, until its end."""
    file.seek(len(PNG))
    while len(head := file.read(8)) == 8:
        size, kind = struct.unpack(">I4s", head)
        if kind == b"IDAT" and not pixels:
            file.seek(size + 4, os.SEEK_CUR)
            continue
        content, checksum = file.read(size), file.read(4)
        if checksum != struct.pack(">I", zlib.crc32(content, zlib.crc32(kind))):
            raise ValueError("a checksum is wrong, or data are missing")
        yield kind, content
        if kind == b"IEND":
            return
    if pixels:
        raise ValueError("data are missing")


def png_of(chunks: Iterable[tuple[bytes, bytes]]) -> bytes:
    out = [PNG]
    for kind, content in chunks:
        out += (
            struct.pack(">I4s", len(content), kind),
            content,
            struct.pack(">I", zlib.crc32(content, zlib.crc32(kind))),
        )
    return b"".join(out)


def png_header(file: BinaryIO) -> bytes:
    """Return a PNG of all chunks but those of pixels; its EXIF data may stand behind them."""
    return png_of([*png_chunks(file, pixels=False), (b"IDAT", b"")])


def _png_without_end(data: bytes) -> bytes:
    chunks = list(png_chunks(io.BytesIO(data)))
    pixels = b"".join(content for kind, content in chunks if kind == b"IDAT")
    others = [chunk for chunk in chunks if chunk[0] not in (b"IDAT", b"IEND")]
    return png_of(others) + struct.pack(">I4s", len(pixels), b"IDAT") + pixels[:-1]  # zlib's checksum needs it


def _jpeg_without_end(data: bytes) -> tuple[bytes, bytes]:
    frame, scans, ends, at, marker = b"", list[bytes](), list[int](), 2, _MARKER
    progressive = False
    while True:
        found = _MARKER.search(data, at)
        if found is None:
            raise ValueError("its end is missing")
        kind, at = found[1][0], found.end()
        if kind == _EOI:
            break
        if kind in _STANDALONE:
            continue
        begin, at = at + 2, at + int.from_bytes(data[at : at + 2])
        content = data[begin:at]
        if _SOF <= kind <= _LAST_SOF and kind not in _NO_SOF:
            frame, progressive = content, kind == _SOF + 2
            if kind > _SOF + 2:
                raise ValueError("a kind of JPEG that is neither baseline nor progressive")
        elif kind == _DRI and any(content):
            marker = _MARKER_EXCEPT_RESTARTS
        elif kind == _SOS:
            scans.append(content)
            end = marker.search(data, at)
            at = len(data) if end is None else end.start()
            ends.append(at)
    if len(frame) < 6 or not scans:
        raise ValueError("its pixels are missing")
    height, width = struct.unpack_from(">HH", frame, 1)
    if height * width > _MOST_PIXELS * len(data):
        raise ValueError(f"{len(data)} bytes cannot hold {height}x{width} pixels")
    if not progressive and len(scans) == 1 and scans[0][0] == frame[5]:
        return data[: ends[0]] + _READ_AHEAD, b""
    _check_scans(frame, scans)
    parts = [data[begin:end] for begin, end in zip([0, *ends], [*ends, len(data)], strict=True)]
    return data, _OTHER_BYTES.join(parts)


def _check_scans(frame: bytes, scans: list[bytes]) -> None:
    """Raise a ValueError unless the scans have all coefficients of all components, to the last bit."""
    missing = {(component, k) for component in frame[6 : 6 + 3 * frame[5] : 3] for k in range(64)}
    for scan in scans:
        first, last, bits = scan[-3:]
        if not bits & 15:
            missing -= {(component, k) for component in scan[1:-3:2] for k in range(first, last + 1)}
    if missing:
        raise ValueError("some of its scans are missing")


_silencing = threading.Lock()


@contextmanager
def silent_libraries() -> Iterator[None]:
    """Discard what C libraries (libtiff, libpng) print on this process's standard error."""
    with _silencing, open(os.devnull, "wb") as nothing:
        try:
            stderr = os.dup(2)
        except OSError:  # closed
            stderr = -1
        os.dup2(nothing.fileno(), 2)
        try:
            yield
        finally:
            if stderr < 0:
                os.close(2)
            else:
                os.dup2(stderr, 2)
                os.close(stderr)
