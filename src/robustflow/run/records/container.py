"""The container of a record: a zip file with a few named, uncompressed entries, and the JSON in it.

Uncompressed entries have the same bytes with every version of zlib, and a small file cannot expand into a large one.
The reader accepts only the bytes that the writer makes of the same entries, and never writes to disk under a name from
the file. Text that is unsafe to display is refused.
"""

from __future__ import annotations

import io
import json
import re
import unicodedata
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...core.errors import DataError
from ...core.files import json_bytes, read_bounded
from ...core.text import plain

LIMITS = {"record.json": 1 << 16, "manifest.json": 1 << 24, "rows.csv": 1 << 29, "profile.json": 1 << 16}
"""Entries of a record in order, with the maximum size of each in bytes."""
REQUIRED = ("record.json", "manifest.json", "rows.csv")
LONGEST = 2000
"""Maximum length of a text field in a record, in characters."""

_LARGEST = sum(LIMITS.values()) + 1024
_PACK = "give a file written by 'robustflow record pack'"
_DEEPEST = 24
_UNSAFE = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")
"""Unicode categories of characters that control a terminal or the direction of text."""
_PATH = re.compile(r"""(?:^|[\s'"=;,(\[])(?:/[^/\s]+/|~[/\\]|[A-Za-z]:[\\/]|\\\\)""")


def container_bytes(entries: Mapping[str, bytes]) -> bytes:
    """Return the bytes of a record with these entries; the same entries always produce the same bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, limit in LIMITS.items():
            if name not in entries:
                continue
            if len(entries[name]) > limit:
                raise DataError(name, f"{len(entries[name])} bytes; the limit for a record is {limit}")
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o100644 << 16
            file.writestr(info, entries[name])
    return out.getvalue()


def read_file(path: Path) -> bytes:
    """Return the bytes of a record file."""
    if path.is_file() and path.stat().st_size <= _LARGEST:  # reading a pipe could block forever
        return read_bounded(path, _LARGEST, _PACK)
    raise DataError(path, f"not a file of at most {_LARGEST >> 20} MiB; {_PACK}")


def read_container(data: bytes, name: str) -> dict[str, bytes]:
    """Return the entries of a record file."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            infos = file.infolist()
            _check_headers(infos, name)
            entries = {info.filename: file.read(info) for info in infos}
    except DataError:
        raise
    except Exception as error:  # zipfile raises many kinds for a damaged file, not just BadZipFile
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise DataError(name, f"not a record, or damaged ({reason}); download it or pack it again") from error
    # Header fields and gaps that readers ignore could contain anything, so one run could have many SHA-256 hashes.
    if container_bytes(entries) != data:
        raise DataError(name, "not as 'robustflow record pack' writes it (headers, or bytes outside the entries)")
    return entries


def _check_headers(infos: list[zipfile.ZipInfo], name: str) -> None:
    """Check names and sizes before an entry is read."""
    names = [info.orig_filename for info in infos]
    if names != [entry for entry in LIMITS if entry in REQUIRED or entry in names]:
        wrong = next((entry[:60] for entry in names if entry not in LIMITS), ", ".join(names[:9]))
        raise DataError(name, f"not a record: found {wrong!r}; expected each of {', '.join(REQUIRED)} exactly once")
    for info in infos:
        stored = info.compress_type == zipfile.ZIP_STORED and info.compress_size == info.file_size
        if not stored or info.file_size > LIMITS[info.filename]:
            limit = LIMITS[info.filename]
            raise DataError(name, f"{info.filename} is compressed, or claims more than its limit of {limit} bytes")


def read_json(data: bytes, name: str) -> dict[str, Any]:
    """Parse a JSON object that `json_bytes` wrote."""
    try:
        value = json.loads(data)
        if not isinstance(value, dict):
            raise DataError(name, "not a JSON object")
        for where, text in texts(value):
            check_text(text, f"{name}, {where or 'a name'}")
        canonical = json_bytes(value) == data  # refuses NaN
    except (ValueError, RecursionError) as error:
        raise DataError(name, f"not JSON ({plain(str(error), 80)})") from error
    if not canonical:
        raise DataError(name, "not in canonical form (order of keys, notation of numbers, spaces)")
    return value


def check_text(text: str, where: str) -> None:
    r"""Raise for text that is too long to display, or that contains control characters.

    >>> check_text("RAFT\x1b[31m", "author")
    Traceback (most recent call last):
    robustflow.core.errors.DataError: author: 'RAFT�[31m' contains a character that cannot be displayed; remove it
    """
    if len(text) > LONGEST:
        raise DataError(where, f"{len(text)} characters, but a record allows at most {LONGEST}; shorten it")
    if not text.isprintable() and any(unicodedata.category(character) in _UNSAFE for character in text):
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
