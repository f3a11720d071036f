"""The file of a record: a zip with a few named, uncompressed entries, which are `record.json`, the run's manifest
without details that identify a machine, the rows as canonical CSV text and, if they were measured, the costs.

Uncompressed entries have the same bytes with every version of zlib, and a small file cannot expand into a large one.
A run stores Parquet, but its bytes depend on the version of the library. So equal runs are equal files: the reader
accepts only the bytes that the writer makes of the same contents, and never writes to disk under a name from the file.
"""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
from pydantic import Field, field_validator

from ...core.errors import DataError, RunError
from ...core.files import read_bounded
from ...core.text import plain
from ...core.types import Untrusted
from ...metrics.rows import ROW_KEY, ROW_SCHEMA
from ..costs import PROFILE
from ..manifest import Manifest

VERSION = 4
"""Version of a record's contents, incremented when the contents or their meaning change."""
LIMITS = {"record.json": 1 << 16, "manifest.json": 1 << 24, "rows.csv": 1 << 29, PROFILE: 1 << 16}
"""Entries of a record in order, with the maximum size of each in bytes."""
REQUIRED = ("record.json", "manifest.json", "rows.csv")
MOST_ROWS = 2_000_000

_LARGEST = sum(LIMITS.values()) + 1024
_LONGEST_TEXT = 2000
_PACK = "give a file written by 'robustflow record pack'"
_UNSAFE = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")
"""Unicode categories of characters that control a terminal or the direction of text."""
_PATH = re.compile(r"""(?:^|[\s'"=;,(\[])(?:/[^/\s]+/|~[/\\]|[A-Za-z]:[\\/]|\\\\)""")
_HEADING = (",".join(ROW_SCHEMA) + "\n").encode()


class Record(Untrusted):
    """`record.json`: the version of the file, whether all planned rows are in it, and what the submitter wrote: author,
    link and description are arbitrary plain text."""

    format: Literal["robustflow-record"] = "robustflow-record"
    version: Literal[4] = 4
    complete: bool
    author: Annotated[str, Field(max_length=200)] = ""
    link: Annotated[str, Field(max_length=500)] = ""
    description: Annotated[str, Field(max_length=2000)] = ""

    @field_validator("link")
    @classmethod
    def _web_address(cls, link: str) -> str:
        if link and not link.startswith("https://"):
            raise ValueError("a link must begin with https://")
        return link


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
    """Return the entries of a record file, none of which is read if the names or the claimed sizes are wrong."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            infos = file.infolist()
            names = [info.orig_filename for info in infos]
            if names != [entry for entry in LIMITS if entry in REQUIRED or entry in names]:
                raise ValueError(f"has the entries {', '.join(names[:9])[:80]!r} instead of {', '.join(REQUIRED)}")
            if sum(info.file_size for info in infos) > len(data):
                raise ValueError("has compressed entries")
            entries = {info.filename: file.read(info) for info in infos}
        # Header fields and gaps that readers ignore could contain anything, so one run could have many SHA-256 hashes.
        if container_bytes(entries) != data:
            raise ValueError("not as 'robustflow record pack' writes it")
    except Exception as error:  # zipfile raises many kinds for a damaged file, not just BadZipFile
        reason = f"{type(error).__name__}: {plain(str(error), 160)}"
        raise DataError(name, f"not a record, or damaged ({reason}); download it or pack it again") from error
    return entries


def check_text(text: str, where: str) -> None:
    r"""Raise for text that is too long to display, or that contains control characters.

    >>> check_text("RAFT\x1b[31m", "author")
    Traceback (most recent call last):
    robustflow.core.errors.DataError: author: 'RAFT�[31m'...
    """
    if len(text) > _LONGEST_TEXT:
        raise DataError(where, f"{len(text)} characters, but a record allows at most {_LONGEST_TEXT}; shorten it")
    if not text.isprintable() and any(unicodedata.category(character) in _UNSAFE for character in text):
        raise DataError(where, f"'{plain(text, 60)}' contains a character that cannot be displayed; remove it")


def texts(value: Any, where: str = "") -> Iterator[tuple[str, str]]:
    """Yield every text inside a JSON value, including keys, with its position."""
    if isinstance(value, str):
        yield where, value
    elif isinstance(value, dict):
        for name, part in value.items():
            yield where, name
            yield from texts(part, f"{where}.{name}" if where else name)
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from texts(part, f"{where}.{index}")


def holds_path(text: str) -> bool:
    """Return whether a text contains a local path: an absolute path, or a path relative to a home folder.

    >>> [holds_path(t) for t in ("/home/ada/w.pth", "~/w.pth", "--data /data/kitti", "a/b.png", "1/2 / 3")]
    [True, True, True, False, False]
    >>> holds_path("https://example.org/a/b")
    False
    """
    return _PATH.search(text) is not None


def shareable_manifest(manifest: Manifest, keep_paths: bool = False) -> Manifest:
    """Return a run's manifest as stored in a record: file names without folders, kind of machine, versions, times.

    Raises:
        RunError: a text contains a path on this machine, but is part of the run's identity and cannot be left out;
            `keep_paths` allows such texts.
    """
    out = manifest.shareable()
    for where, text in () if keep_paths else texts(json.loads(out.document())):
        if holds_path(text):
            raise RunError(
                where or "manifest.json",
                f"'{plain(text, 60)}' is a path on this machine that would be published; run again with a "
                "relative path, or give --keep-paths",
            )
    return out


def rows_to_text(rows: pl.DataFrame) -> bytes:
    """Return a run's rows as CSV: a header, then one line per row in the order of `ROW_KEY`; null is an empty cell, and
    numbers have the fewest digits that restore the same value."""
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\n").writerows(rows.select(list(ROW_SCHEMA)).sort(ROW_KEY).iter_rows())
    return _HEADING + out.getvalue().encode()


def rows_from_text(text: bytes) -> pl.DataFrame:
    """Parse CSV text into rows with the columns and types of `ROW_SCHEMA`."""
    if not text.startswith(_HEADING):
        raise DataError("rows.csv", "does not have the columns of this version; use the version that packed it")
    lines = text.count(b"\n") - 1
    if not 0 < lines <= MOST_ROWS:
        raise DataError("rows.csv", f"has {lines} lines; a record has 1 to {MOST_ROWS} rows")
    try:
        rows = pl.read_csv(io.BytesIO(text), schema=ROW_SCHEMA)
        same = rows_to_text(rows) == text
    # A panic inside polars is not a PolarsError, nor even an Exception.
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, UnicodeError, ValueError) as error:
        raise DataError("rows.csv", f"cannot be read ({' '.join(str(error).split())[:120]})") from error
    if not same:
        raise DataError("rows.csv", "not in canonical form: sorted by sample, corruption and severity")
    return rows
