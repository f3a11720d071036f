"""A shared folder of records, from which a leaderboard in a git repository is generated.

    FOLDER/records/<first 16 digits of the SHA-256>.robustflow    the records, as submitted
    FOLDER/records.json                                            their list, one entry per record

Only records that pass verification are stored, and no text from a record is used as a file name. The list is sorted and
has one canonical form, so that changes can be reviewed line by line.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...core.errors import DataError
from ...core.files import make_folder, write_bytes, write_json
from ..run import Run
from .container import read_file
from .pack import SUFFIX, record_bytes
from .read import Reader
from .verify import verified

LIST = "records.json"
RECORDS = "records"
VERSION = 3
"""Version of `records.json`."""
_ENTRY = ("file", "sha256", "model", "benchmark", "sentence")


class Added(NamedTuple):
    """The result of `add_records`."""

    copies: Sequence[Path]
    earlier: Sequence[str]


def add_records(folder: Path, sources: Sequence[Path], supersede: bool = False) -> Added:
    """Verify records and copy either all or none of them into a collection. A missing collection is created."""
    before = {entry["file"]: entry for entry in _entries(folder)}
    contents: dict[Path, bytes] = {}
    added = {}
    for file in sources:
        data = record_bytes(Run(file)) if file.is_dir() else read_file(file)
        reader = Reader(data, str(file))
        subject = verified(reader)
        name = f"{RECORDS}/{reader.sha256[:16]}{SUFFIX}"
        values = (name, reader.sha256, subject.model, subject.benchmark, subject.sentence())
        added[name] = dict(zip(_ENTRY, values, strict=True))
        contents[folder / name] = data
    about = {(entry["model"], entry["benchmark"]) for entry in added.values()}
    earlier = {
        name: entry
        for name, entry in before.items()
        if name not in added and (entry["model"], entry["benchmark"]) in about
    }
    entries = before | added
    make_folder(folder / RECORDS)
    for path, data in contents.items():
        write_bytes(path, data)
    listed = [entries[name] for name in sorted(entries) if not (supersede and name in earlier)]
    write_json(folder / LIST, {"version": VERSION, "records": listed})
    for name in earlier if supersede else ():
        (folder / name).unlink()
    return Added(list(contents), [f"{name} ({entry['sentence']})" for name, entry in earlier.items()])


def is_collection(folder: Path) -> bool:
    """Return whether a folder has a list of records."""
    return (folder / LIST).is_file()


def collected(folder: Path) -> list[Path]:
    """Return the records of a collection."""
    paths = []
    for entry in _entries(folder):
        paths.append(folder / entry["file"])
        if hashlib.sha256(read_file(paths[-1])).hexdigest() != entry["sha256"]:
            raise DataError(
                paths[-1], f"not the file listed in {LIST}; restore it, or remove its entry and add it again"
            )
    return paths


def _entries(folder: Path) -> list[dict[str, Any]]:
    if not is_collection(folder):
        return []
    path = folder / LIST
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if (version := document["version"]) != VERSION:
            raise DataError(path, f"has version {str(version)[:20]}, but version {VERSION} is required")
        entries = [{key: str(entry[key]) for key in _ENTRY} for entry in document["records"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(path, "not a list of records; restore it, or add the records to a new folder") from error
    for entry in entries:
        if entry["file"] != f"{RECORDS}/{entry['sha256'][:16]}{SUFFIX}" or not entry["sha256"].isalnum():
            raise DataError(path, f"{entry['file'][:60]!r} is not named after its hash; add the record again")
        if not (folder / entry["file"]).is_file():
            raise DataError(folder / entry["file"], f"listed in {LIST} but missing; restore it, or remove its entry")
    return entries
