"""A shared folder of records, from which a leaderboard in a git repository is generated.

    FOLDER/records/<first 16 digits of the SHA-256>.robustflow    the records, as submitted

Only records that pass verification are stored, and no text from a record is used as a file name.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ...core.errors import RobustFlowError
from ...core.files import make_folder, write_bytes
from ...core.text import plain
from ..run import Run
from .pack import SUFFIX, record_bytes
from .read import Reader
from .verify import verified

RECORDS = "records"


class Added(NamedTuple):
    """The result of `add_records`."""

    copies: Sequence[Path]
    earlier: Sequence[str]


def add_records(folder: Path, sources: Sequence[Path], supersede: bool = False) -> Added:
    """Verify records and copy either all or none of them into a collection. A missing collection is created."""
    added: dict[Path, bytes] = {}
    new = set()
    for source in sources:
        reader = Reader(record_bytes(Run(source)) if source.is_dir() else source, str(source))
        about = verified(reader)
        new.add((about.model, about.benchmark))
        added[folder / RECORDS / f"{reader.sha256[:16]}{SUFFIX}"] = reader.data
    earlier = {}
    for path in collected(folder):
        with suppress(RobustFlowError):  # a damaged record is left out of the leaderboard, which says so
            run = Reader(path).open(Run)
            model, benchmark = plain(run.name), plain(run.benchmark)
            if path not in added and (model, benchmark) in new:
                earlier[path] = f"{RECORDS}/{path.name} ({model} ({run.setting}) on {benchmark})"
    make_folder(folder / RECORDS)
    for path, data in added.items():
        write_bytes(path, data)
    for path in earlier if supersede else ():
        path.unlink()
    return Added(list(added), list(earlier.values()))


def is_collection(folder: Path) -> bool:
    """Return whether a folder contains a folder of records."""
    return (folder / RECORDS).is_dir()


def collected(folder: Path) -> list[Path]:
    """Return the records of a collection."""
    return sorted((folder / RECORDS).glob(f"*{SUFFIX}"))
