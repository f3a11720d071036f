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
import struct
import threading
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"

_MOST_PIXELS = 512
"""Pixels per byte that a JPEG can hold: each block of 8x8 takes at least one bit."""

_MOST_SCANS = 500
"""Each scan takes the time of a whole picture; programs write at most some dozen."""

_READ_AHEAD = b"\xfe" * 8
_OTHER_BYTES = bytes(range(1, 255)) * 4

_SOF, _LAST_SOF, _RST, _EOI, _SOS, _DRI = 0xC0, 0xCF, 0xD0, 0xD9, 0xDA, 0xDD
_NO_SOF = (0xC4, 0xC8, 0xCC)
_STANDALONE = (0x01, *range(0xD0, 0xD8))


def without_end(data: bytes) -> tuple[bytes, bytes]:
    """Return the data of a picture without their end, and, for a JPEG of several scans, the other variant of the data,
    otherwise nothing. Raise a ValueError if the data are too short."""
    if data.startswith(PNG):
        return _png_without_end(data), b""
    return _jpeg_without_end(data) if data.startswith(JPEG) else (data, b"")


def _png_chunks(file: BinaryIO, pixels: bool = True) -> Iterator[tuple[bytes, bytes]]:
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


def _png_of(chunks: Iterable[tuple[bytes, bytes]]) -> bytes:
    out = [PNG]
    for kind, content in chunks:
        checksum = zlib.crc32(content, zlib.crc32(kind))
        out += struct.pack(">I4s", len(content), kind), content, struct.pack(">I", checksum)
    return b"".join(out)


def png_header(file: BinaryIO) -> bytes:
    """Return a PNG of all chunks but those of pixels; its EXIF data may stand behind them."""
    return _png_of([*_png_chunks(file, pixels=False), (b"IDAT", b"")])


def _png_without_end(data: bytes) -> bytes:
    others, pixels = list[tuple[bytes, bytes]](), list[bytes]()
    for kind, content in _png_chunks(io.BytesIO(data)):
        if kind == b"IDAT":
            pixels += [content] if content else []
        elif kind != b"IEND":
            others.append((kind, content))
    pixels[-1:] = [content[:-1] for content in pixels[-1:]]  # zlib's checksum needs the last byte
    return b"".join((_png_of(others), struct.pack(">I4s", sum(map(len, pixels)) + 1, b"IDAT"), *pixels))


def _jpeg_without_end(data: bytes) -> tuple[bytes, bytes]:
    values = np.frombuffer(data, np.uint8)
    places = np.flatnonzero(values[:-1] == 255)
    places = places[values[places + 1] - np.uint8(1) < 254]  # neither 0 nor 255 follows
    markers = places
    """Where a marker may stand; those in the data of a scan end it."""
    frame, scans, ends, at, progressive = b"", list[bytes](), [0], 2, False
    other = list[bytes]()
    while True:
        at = _first(places, at, len(data))
        if at == len(data):
            raise ValueError("its end is missing")
        kind, at = data[at + 1], at + 2
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
            markers = places[values[places + 1] & 0xF8 != _RST]
        elif kind == _SOS:
            scans.append(content)
            if len(scans) > _MOST_SCANS:
                raise ValueError(f"more than {_MOST_SCANS} scans")
            begin, at = at, _first(markers, at, len(data))
            ends.append(at)
            other += data[ends[-2] : at], _OTHER_BYTES
            if markers is not places:  # of a further part of the scan
                restarts = int(np.searchsorted(places, at) - np.searchsorted(places, begin))
                other += bytes((0xFF, _RST + restarts % 8)), _OTHER_BYTES
    if len(frame) < 6 or not scans:
        raise ValueError("its pixels are missing")
    height, width = struct.unpack_from(">HH", frame, 1)
    if height * width > _MOST_PIXELS * len(data):
        raise ValueError(f"{len(data)} bytes cannot hold {height}x{width} pixels")
    if not progressive and len(scans) == 1 and scans[0][0] == frame[5]:
        return data[: ends[1]].rstrip(b"\xff") + _READ_AHEAD, b""
    _check_scans(frame, scans)
    return data, b"".join((*other, data[ends[-1] :]))


def _first(places: npt.NDArray[np.int64], begin: int, end: int) -> int:
    place = int(np.searchsorted(places, begin))
    return int(places[place]) if place < places.size else end


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
