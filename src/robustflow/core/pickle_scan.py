"""Read an untrusted file of tensors, written by PyTorch or safetensors: the only call of `torch.load`."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO

from .pickle_opcodes import IGNORED, LARGEST, RefusedError, scan_pickle

_CHUNK = 2**20
_END = struct.Struct("<4s4H2LH")
_END64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR = struct.Struct("<4sLQL")
_ENTRY = struct.Struct("<4s6H3L5H2L")
_LOCAL = struct.Struct("<4s5H3L2H")
_IN_DESCRIPTOR, _UTF8 = 1 << 3, 1 << 11
"""Flags of an entry: its size follows its content; its name is UTF-8."""
_FOLDER = 1 << 4
"""Attribute of an entry that PyTorch takes for a folder: it does not read the content, and returns unset memory."""


class _Unread:
    """A placeholder for objects that training scripts store with the weights; it ignores all its arguments."""

    def __new__(cls, *args: Any) -> _Unread:
        return super().__new__(cls)

    def __setstate__(self, state: Any) -> None:
        pass


def load_tensors(file: BinaryIO) -> Any:
    """Return the content of a file from its start: tensors, in dicts and lists, with numbers and texts.

    Raises:
        RefusedError: it contains more than that, or costs more memory or time than its size explains.
        Exception: the libraries raise any exception on a damaged file.
    """
    import safetensors.torch
    import torch

    file.seek(0)
    start = file.read(9)
    file.seek(0)
    if start[4:] == b"\0\0\0\0{":  # safetensors: the length of the header in 8 bytes, then the header in JSON
        if (length := int.from_bytes(start[:8], "little")) > LARGEST:
            raise RefusedError(f"a header of {length} bytes")
        return safetensors.torch.load(file.read())
    scan_torch_file(file)
    with warnings.catch_warnings(), torch.serialization.safe_globals([(_Unread, name) for name in IGNORED]):
        warnings.simplefilter("ignore")  # pickle protocol warnings; unreadable files raise an error anyway
        return torch.load(file, weights_only=True, map_location="cpu")


def scan_torch_file(file: BinaryIO) -> None:
    """Check a file written by `torch.save`; afterwards, the file is positioned at its start."""
    size = file.seek(0, 2)
    file.seek(0)
    if file.read(4) == b"PK\x03\x04":
        scan_pickle(_pickle_of_archive(file, size), size)
    else:  # the format before PyTorch 1.6: the content is the fourth of five pickles
        position = 0
        for _ in range(5):
            file.seek(position)
            position += scan_pickle(file.read(LARGEST - position), size)
    file.seek(0)


def _pickle_of_archive(file: BinaryIO, size: int) -> bytes:
    """Return the pickle of an archive that every program reads alike: its only directory is directly before its end,
    and names entries that are stored one after the other."""
    first, names, after, content = "", set[str](), 0, None
    for name, offset, length, checksum, flags in _entries(file, size):
        file.seek(offset)
        header = file.read(_LOCAL.size)
        _, _, local_flags, method, _, _, _, packed, unpacked, name_length, extra = _LOCAL.unpack(header)
        begin = offset + _LOCAL.size + name_length + extra
        sizes = ((length, length), (0, 0)) if flags & _IN_DESCRIPTOR else ((length, length),)
        same = header[:4] == b"PK\x03\x04" and (local_flags, method) == (flags, 0) and (packed, unpacked) in sizes
        if not same or file.read(name_length) != name.encode() or offset < after:
            raise ValueError(f"two descriptions of entry {name[:60]} differ, or two entries overlap")
        after = begin + length
        # PyTorch searches names regardless of case, in the folder of the first record
        if name.lower() in names:
            raise ValueError(f"two entries are named {name[:60]}")
        names.add(name.lower())
        first = first or name
        wanted = name == first.partition("/")[0] + "/data.pkl"
        if wanted and length > LARGEST:
            raise RefusedError(f"a pickle of {length} bytes")
        file.seek(begin)
        found = 0
        for position in range(0, length, _CHUNK):
            part = file.read(min(_CHUNK, length - position))
            found = zlib.crc32(part, found)
        if found != checksum:
            raise ValueError(f"checksum mismatch in {name[:60]}")
        if wanted:
            file.seek(begin)
            content = file.read(length)
    if content is None:
        raise ValueError("it has no data.pkl")
    return content


def _entries(file: BinaryIO, size: int) -> Iterator[tuple[str, int, int, int, int]]:
    """Yield name, position, size, checksum and flags of each entry, in the order of the directory."""
    file.seek(max(size - _END.size - _LOCATOR.size - _END64.size, 0))
    tail = file.read()
    end = size - _END.size
    mark, *disks, count, total, length, begin, comment = _END.unpack(tail[-_END.size :])
    if mark != b"PK\x05\x06" or any(disks) or count != total or comment:
        raise ValueError("the end of the archive is missing, or has a comment")
    if tail[-_END.size - _LOCATOR.size :][:4] == b"PK\x06\x07":
        end -= _LOCATOR.size + _END64.size
        mark, disk, position, number = _LOCATOR.unpack(tail[-_END.size - _LOCATOR.size : -_END.size])
        mark64, rest, _, _, *disks, count64, total, length64, begin64 = _END64.unpack(tail[: _END64.size])
        where = (position, disk, number, mark64, rest, *disks, count64)
        saturated = ((count, 0xFFFF, count64), (length, 2**32 - 1, length64), (begin, 2**32 - 1, begin64))
        if where != (end, 0, 1, b"PK\x06\x06", _END64.size - 12, 0, 0, total) or any(
            short not in (most, long) for short, most, long in saturated
        ):
            raise ValueError("two directories of the archive differ")
        count, length, begin = count64, length64, begin64
    if begin + length != end:
        raise ValueError("the directory is not at the end of the archive")
    file.seek(begin)
    directory, at = file.read(length), 0
    for _ in range(count):
        mark, _, _, flags, method, _, _, checksum, packed, unpacked, *more = _ENTRY.unpack_from(directory, at)
        name_length, extra, comment, disk, _, attributes, offset = more
        name = directory[at + _ENTRY.size :][:name_length]
        at += _ENTRY.size + name_length + extra + comment
        unusual = flags & ~(_IN_DESCRIPTOR | _UTF8) or attributes & _FOLDER or name.endswith(b"/")
        if mark != b"PK\x01\x02" or disk or unusual or not name.isascii() or b"\0" in name:
            raise ValueError("an entry of the directory is damaged, or not a file")
        if method or packed != unpacked or not offset + packed <= begin:  # torch.save does not compress
            raise RefusedError(f"its {size} bytes would unpack to more than {unpacked}")
        yield name.decode(), offset, packed, checksum, flags
    if at != length:
        raise ValueError("the directory has more entries than it states")
