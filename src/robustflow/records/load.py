"""A run from wherever it lies: what every command that reads runs takes."""

from __future__ import annotations

import shutil
import weakref
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING

from ..errors import RunError

if TYPE_CHECKING:
    from ..runs.run import Result


def load_run(path: str | Path) -> Result:
    """The run of a folder that `run` wrote, or of a record that `pack` wrote.

    A record is verified first; its run lies in a temporary folder that goes when the result is no longer used.

    Raises:
        RunError: no run there, one that this version cannot read, or a record that does not verify.
        DataError: the file cannot be read.
    """
    from ..runs.run import Result

    path = Path(path).expanduser()
    return _open_record(path) if path.is_file() else Result(path)


def is_record(path: str | Path) -> bool:
    """Whether a path is a file that begins as a record does (with a zip's first entry, `record.json`)."""
    try:
        with open(path, "rb") as file:
            head = file.read(64)
    except OSError:
        return False
    return head.startswith(b"PK\x03\x04") and head[30:].startswith(b"record.json")


def _open_record(path: Path) -> Result:
    from ..runs.run import Result
    from .container import read_file
    from .read import Reader
    from .verify import verify_read

    if not is_record(path):
        raise RunError(f"{path} is neither a run's folder nor a record; give what 'run' or 'pack' wrote")
    reader = Reader(read_file(path), str(path))
    found = verify_read(reader)
    if not found.ok:
        raise RunError(f"{path} does not verify: {found.first_failure()}; robustflow verify {path} says more")
    folder = Path(mkdtemp(prefix="robustflow-"))
    try:
        reader.extract(folder)
        result = Result(folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(result, shutil.rmtree, folder, True)
    return result
