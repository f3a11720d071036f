"""A shared folder of records, from which a leaderboard in a git repository is generated.

    FOLDER/records/<first 16 digits of the SHA-256>.robustflow    the records, as submitted
    FOLDER/records.json                                            their list, one entry per record

Only records that pass verification are stored, and no text from a record is used as a file name. The list is sorted and
has one canonical form, so that changes can be reviewed line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, ValidationError

from ...core.errors import DataError, first_misfit
from ...core.files import json_bytes, make_folder, read_bounded, write_bytes
from ...core.types import Untrusted
from ..run import Run
from .pack import SUFFIX, record_bytes
from .read import Reader
from .verify import verified

LIST = "records.json"
RECORDS = "records"
_LARGEST = 1 << 26


class Entry(Untrusted):
    """A record of a collection, whose file is named after its hash."""

    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    model: str
    benchmark: str
    sentence: str

    @property
    def file(self) -> str:
        return f"{RECORDS}/{self.sha256[:16]}{SUFFIX}"


class Collection(Untrusted):
    """The content of `records.json`."""

    version: Literal[4] = 4
    records: tuple[Entry, ...] = ()


class Added(NamedTuple):
    """The result of `add_records`."""

    copies: Sequence[Path]
    earlier: Sequence[str]


def add_records(folder: Path, sources: Sequence[Path], supersede: bool = False) -> Added:
    """Verify records and copy either all or none of them into a collection. A missing collection is created."""
    before = {entry.file: entry for entry in _read(folder)}
    contents: dict[Path, bytes] = {}
    added: dict[str, Entry] = {}
    for source in sources:
        reader = Reader(record_bytes(Run(source)) if source.is_dir() else source, str(source))
        about = verified(reader)
        entry = Entry(sha256=reader.sha256, model=about.model, benchmark=about.benchmark, sentence=about.sentence)
        added[entry.file], contents[folder / entry.file] = entry, reader.data
    new = {(entry.model, entry.benchmark) for entry in added.values()}
    earlier = [e for name, e in before.items() if name not in added and (e.model, e.benchmark) in new]
    gone = {entry.file for entry in earlier} if supersede else set()
    make_folder(folder / RECORDS)
    for path, data in contents.items():
        write_bytes(path, data)
    listed = [entry for name, entry in sorted((before | added).items()) if name not in gone]
    write_bytes(folder / LIST, json_bytes(Collection(records=tuple(listed)).model_dump()))
    for name in gone:
        (folder / name).unlink()
    return Added(list(contents), [f"{entry.file} ({entry.sentence})" for entry in earlier])


def is_collection(folder: Path) -> bool:
    """Return whether a folder has a list of records."""
    return (folder / LIST).is_file()


def collected(folder: Path) -> list[Path]:
    """Return the records of a collection."""
    paths = []
    for entry in _read(folder):
        path = folder / entry.file
        if not path.is_file() or Reader(path).sha256 != entry.sha256:
            raise DataError(path, f"not the file listed in {LIST}; restore it, or remove its entry and add it again")
        paths.append(path)
    return paths


def _read(folder: Path) -> tuple[Entry, ...]:
    if not is_collection(folder):
        return ()
    remedy = "restore it, or add the records to a new folder"
    try:
        return Collection.model_validate_json(read_bounded(folder / LIST, _LARGEST, remedy)).records
    except ValidationError as error:
        raise DataError(folder / LIST, f"not a list of records ({first_misfit(error)}); {remedy}") from error
