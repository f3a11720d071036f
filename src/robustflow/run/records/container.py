"""Strictly parse JSON from untrusted sources, and reject text that is unsafe to display. The container of a record:
a zip file with a few named, uncompressed entries.

Uncompressed entries have the same bytes with every version of zlib, and a small file cannot expand into a large one.
The reader only accepts entries with the expected names, and never writes to disk under a name from the file.
"""

from __future__ import annotations

import io
import json
import re
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...core.errors import DataError
from ...core.files import json_bytes, read_bounded
from ...core.text import plain

LONGEST = 2000
"""Maximum length of a text field in a record, in characters."""

_DEEPEST = 24
_PATH = re.compile(r"""(?:^|[\s'"=;,(\[])(?:/[^/\s]+/|~[/\\]|[A-Za-z]:[\\/]|\\\\)""")


def read_json(data: bytes, name: str) -> dict[str, Any]:
    """Parse a JSON object that `json_bytes` wrote."""
    try:
        value = json.loads(data.decode(), parse_constant=_refuse)
        if not isinstance(value, dict):
            raise DataError(f"{name} is not a JSON object")
        for where, text in texts(value):
            check_text(text, f"{name}, {where or 'a name'}")
        canonical = json_bytes(value) == data
    except (ValueError, RecursionError) as error:
        raise DataError(f"{name} is not JSON ({plain(str(error), 80)})") from error
    if not canonical:
        raise DataError(f"{name} is not in canonical form (order of keys, notation of numbers, spaces)")
    return value


def check_text(text: str, where: str) -> None:
    r"""Raise for text that is too long to display, or that contains control characters.

    >>> check_text("RAFT\x1b[31m", "author")
    Traceback (most recent call last):
    robustflow.core.errors.DataError: author: 'RAFT�[31m' contains a character that cannot be displayed; remove it
    """
    if len(text) > LONGEST:
        raise DataError(where, f"{len(text)} characters, but a record allows at most {LONGEST}; shorten it")
    if not text.isprintable() and any(unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co", "Zl", "Zp") for c in text):
        raise DataError(where, f"'{plain(text, 60)}' contains a character that cannot be displayed; remove it")


def texts(value: Any) -> Iterator[tuple[str, str]]:
    """Yield every text inside a JSON value, including keys, with its position."""
    left: list[tuple[tuple[str, ...], Any]] = [((), value)]
    while left:
        where, one = left.pop()
        if len(where) > _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} levels deep")
        if isinstance(one, str):
            yield ".".join(part[:40] for part in where), one
        elif isinstance(one, dict):
            yield from (("", name) for name in one)
            left += [((*where, name), part) for name, part in one.items()]
        elif isinstance(one, list):
            left += [((*where, str(index)), part) for index, part in enumerate(one)]


def holds_path(text: str) -> bool:
    """Return whether a text contains a local path: an absolute path, or a path relative to a home folder.

    >>> [holds_path(t) for t in ("/home/ada/w.pth", "~/w.pth", "--data /data/kitti", "a/b.png", "1/2 / 3")]
    [True, True, True, False, False]
    >>> holds_path("https://example.org/a/b")
    False
    """
    return _PATH.search(text) is not None


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not a number")


LIMITS = {
    "record.json": 1 << 16,
    "manifest.json": 1 << 24,
    "rows.csv": 1 << 29,
    "summary.json": 1 << 24,
    "profile.json": 1 << 16,
}
"""Entries of a record in order, with the maximum size of each in bytes."""

REQUIRED = ("record.json", "manifest.json", "rows.csv", "summary.json")

_LOCAL, _CENTRAL, _END = 30, 46, 22
"""Sizes of the zip format's headers without names, in bytes."""
_UNREADABLE = (
    *(zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError, RuntimeError),
    *(struct.error, zlib.error, OverflowError, MemoryError, IndexError, KeyError),
)
"""Exceptions that zipfile raises for a damaged file, which are not limited to BadZipFile."""
_LARGEST = sum(LIMITS.values()) + len(LIMITS) * (_LOCAL + _CENTRAL + 64) + _END


def container_bytes(entries: Mapping[str, bytes]) -> bytes:
    """Return the bytes of a record with these entries; the same entries always produce the same bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, limit in LIMITS.items():
            if name not in entries:
                continue
            if len(entries[name]) > limit:
                raise DataError(f"{name} of this run has {len(entries[name])} bytes; the limit for a record is {limit}")
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o100644 << 16
            file.writestr(info, entries[name])
    return out.getvalue()


def read_file(path: Path) -> bytes:
    """Return the bytes of a record file."""
    if path.exists() and not path.is_file():  # reading a pipe could block forever
        raise DataError(f"{path} is not a file; give a file written by 'robustflow record pack'")
    return read_bounded(path, _LARGEST, "give a file written by 'robustflow record pack'")


def read_container(data: bytes, name: str) -> dict[str, bytes]:
    """Return the entries of a record file."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            infos = file.infolist()
            _check(infos, file, len(data), name)
            entries = {info.filename: file.read(info) for info in infos}
    except DataError:
        raise
    except _UNREADABLE as error:
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise DataError(f"{name} is not a record or is damaged ({reason}); download it or pack it again") from error
    # Header fields that readers ignore could contain anything, so one run could have many SHA-256 hashes.
    if container_bytes(entries) != data:
        raise DataError(name, "its zip headers differ from those of 'robustflow record pack'; pack the run again")
    return entries


def _check(infos: list[zipfile.ZipInfo], file: zipfile.ZipFile, size: int, name: str) -> None:
    names = [info.orig_filename for info in infos]
    if names != [entry for entry in LIMITS if entry in REQUIRED or entry in names]:
        wrong = next((entry for entry in names if entry not in LIMITS), None)
        reason = f"found {wrong[:60]!r}" if wrong is not None else f"found {', '.join(names[:9]) or 'nothing'}"
        raise DataError(f"{name} is not a valid record: {reason}; expected each of {', '.join(REQUIRED)} exactly once")
    end = 0
    for info in infos:
        if info.file_size > LIMITS[info.filename]:
            raise DataError(
                name, f"{info.filename} claims {info.file_size} bytes; the limit is {LIMITS[info.filename]}"
            )
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise DataError(name, f"{info.filename} is compressed, but the entries of a record must not be")
        if info.flag_bits or info.external_attr != 0o100644 << 16 or info.extra or info.comment:
            raise DataError(name, f"{info.filename} is not a plain entry (encrypted, a link, or with extra fields)")
        if info.header_offset != end:
            raise DataError(name, "there are bytes between its entries, or two entries overlap")
        end += _LOCAL + len(info.filename) + info.file_size
    directory = sum(_CENTRAL + len(info.filename) for info in infos)
    if file.start_dir != end or size != end + directory + _END or file.comment:
        raise DataError(name, "there are bytes before or after the record")
