"""What a run's `summary.json` and `report.html` were made from, so that neither is made again while that is the same.

Kept in a hidden file of the folder: for each file its own digest, and one of everything that decides it: the rows as
they are read now, the manifest, what is beside them, and the code that makes it. Where any of it differs, or the
hidden file is damaged, the file is made again. A file that was changed by hand is made again too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..atomic import write_json
from ..digest import digest_of_bytes, digest_of_value

RECORD = ".made_from.json"
_MADE = ("summary.json", "report.html")
_NOT_BESIDE = ("rows", "clean", "manifest.json", "source.json", *_MADE)
_LARGEST = 2**28


def rows_digest(rows: pl.DataFrame) -> str:
    """A hash of rows, of every column in the order given; the same for the same rows however they are stored."""
    return digest_of_bytes(*(part for name in rows.columns for part in _bytes_of(rows[name])))


def made_from(folder: Path, rows: pl.DataFrame, *, beside: bool) -> str:
    """The hash of what a file of a run is made from.

    Args:
        folder: of the run.
        rows: of the run.
        beside: whether it also shows what is kept beside the rows: pictures, costs, displacements.
    """
    manifest = _read(folder / "manifest.json") or b""
    files = list(_files(folder)) if beside else []
    return digest_of_value([rows_digest(rows), digest_of_bytes(manifest), files, _code()], size=16)


def is_current(folder: Path, name: str, source: str) -> bool:
    """Whether a file of a run is there, unchanged, and was made from the same."""
    entry = _entries(folder).get(name)
    if not isinstance(entry, dict) or entry.get("made_from") != source:
        return False
    data = _read(folder / name)
    return data is not None and entry.get("digest") == digest_of_bytes(data)


def note_made(folder: Path, name: str, source: str) -> None:
    """Note what a file of a run, just written, was made from."""
    data = _read(folder / name)
    if data is not None:
        entry = {"made_from": source, "digest": digest_of_bytes(data)}
        write_json(folder / RECORD, {**_entries(folder), name: entry})


def _bytes_of(column: pl.Series) -> Iterator[bytes]:
    yield f"{column.name} {column.dtype} {len(column)}".encode()
    yield column.is_null().to_numpy().tobytes()
    if column.dtype == pl.String:
        filled = column.fill_null("")
        yield filled.str.len_bytes().to_numpy().astype("<u4").tobytes()
        yield "".join(filled.to_list()).encode()
    else:
        values = column.fill_null(0).to_numpy()
        yield np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()


def _entries(folder: Path) -> dict[str, Any]:
    try:
        entries = json.loads(_read(folder / RECORD) or b"{}")
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
    """What is in a run's folder besides rows, clean flows and what is made from them: name, size, time of change."""
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in inside.parts)
        if not hidden and inside.parts[0] not in _NOT_BESIDE and path.is_file():
            stat = path.stat()
            yield str(inside), stat.st_size, stat.st_mtime_ns


@cache
def _code() -> str:
    """This package as it is installed: name, size and time of change of its files."""
    package = Path(__file__).parents[1]
    files = [path for path in sorted(package.rglob("*")) if "__pycache__" not in path.parts and path.is_file()]
    stats = [(str(path.relative_to(package)), path.stat()) for path in files]
    return digest_of_value([(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats], size=16)
