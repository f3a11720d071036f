"""Track whether files made from a run's rows are up to date: `summary.json`, `report.html`, and the values that
pages use. Cache the values that pages show about a run, apart from its means, in a hidden file in the run's
folder. They are valid only for the rows from which they were computed.

A hidden file in the folder contains, for each file, its digest and a digest of everything it depends on: the bytes of
the shards, the manifest, the other files of the folder, and the code. If any of these differs, or the file was edited,
it is regenerated. An unchanged run can be shown without decoding a row.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from stat import S_ISREG
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from ..core.files import digest_of_bytes, digest_of_value, json_bytes, write_bytes, write_json
from .manifest import Manifest

STALENESS_FILE = ".staleness.json"
CACHED_VALUES_FILE = ".cached_values.json"
_MADE = ("summary.json", "report.html", CACHED_VALUES_FILE)
_NOT_BESIDE = ("rows", "clean", "manifest.json", "source.json", *_MADE)
_LARGEST = 2**28


def source_digest(folder: Path, rows: str, manifest: Manifest, *, beside: bool) -> str:
    """Return a hash of everything from which a file of a run is made."""
    files = list(_files(folder)) if beside else []
    return digest_of_value([rows, digest_of_value(manifest.record(), size=16), files, code_digest()], size=16)


def is_current(folder: Path, name: str, source: str) -> bool:
    """Return whether a file of a run exists, is unchanged, and was made from the same source."""
    entry = _entries(folder).get(name)
    if not isinstance(entry, dict) or entry.get("source") != source:
        return False
    data = _read(folder / name)
    return data is not None and entry.get("digest") == digest_of_bytes(data)


def write_made(folder: Path, name: str, data: bytes, source: str) -> None:
    """Write a file of a run, and record its source with the digest of `data`: another process may replace the file."""
    write_bytes(folder / name, data)
    entry = {"source": source, "digest": digest_of_bytes(data)}
    write_json(folder / STALENESS_FILE, {**_entries(folder), name: entry})


def _entries(folder: Path) -> dict[str, Any]:
    try:
        entries = json.loads(_read(folder / STALENESS_FILE) or b"{}")
    except (ValueError, RecursionError):
        return {}
    return {name: entries[name] for name in _MADE if name in entries} if isinstance(entries, dict) else {}


def _read(path: Path) -> bytes | None:
    try:
        if path.is_file() and path.stat().st_size <= _LARGEST:
            return path.read_bytes()
    except OSError:
        pass
    return None


def _files(folder: Path) -> Iterator[tuple[str, int, int]]:
    """Return name, size and modification time of everything in a run's folder except rows, clean flows and files made
    from them."""
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in inside.parts)
        if not hidden and inside.parts[0] not in _NOT_BESIDE and (stat := _stat(path)) is not None:
            yield str(inside), stat.st_size, stat.st_mtime_ns


@cache
def code_digest() -> str:
    """Return a hash of the installed package: name, size and modification time of its files."""
    package = Path(__file__).parents[1]
    stats = [
        (str(path.relative_to(package)), stat)
        for path in sorted(package.rglob("*"))
        if "__pycache__" not in path.parts and (stat := _stat(path)) is not None
    ]
    return digest_of_value([(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats], size=16)


def _stat(path: Path) -> os.stat_result | None:
    """Return size and modification time of a file; None for anything else, and for a file that disappears in the
    meantime."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat if S_ISREG(stat.st_mode) else None


Cached = TypeVar("Cached")
_LARGEST_CACHED_VALUES = 2**24


class CachedValues:
    """Cached values by name, read once and computed if missing."""

    def __init__(self, folder: Path, source: str) -> None:
        self._folder, self._source = folder, source
        self._known = _read_of_cached_values(folder, source)
        self._new = False

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def get(self, name: str, kind: type[Cached], make: Callable[[], Cached]) -> Cached:
        """Return a value; compute it if it is missing or has a different type."""
        if name in self._known:
            try:
                return TypeAdapter(kind).validate_python(self._known[name])
            except ValidationError:
                pass
        value = make()
        self._known[name], self._new = value, True
        return value

    def write(self) -> None:
        """Store the values computed since the file was read."""
        if self._new:
            write_made(self._folder, CACHED_VALUES_FILE, json_bytes(self._known), self._source)
            self._new = False


def _read_of_cached_values(folder: Path, source: str) -> dict[str, Any]:
    path = folder / CACHED_VALUES_FILE
    try:
        if not is_current(folder, CACHED_VALUES_FILE, source) or path.stat().st_size > _LARGEST_CACHED_VALUES:
            return {}
        values = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}
