"""Read a run from a folder or a record; used by every command that reads runs."""

from __future__ import annotations

import os
import shutil
import weakref
from collections.abc import Iterable
from pathlib import Path
from tempfile import mkdtemp
from typing import TypeVar, overload

from ..errors import RunError
from ..layout import user_path
from ..runs.run import Run

AnyRun = TypeVar("AnyRun", bound=Run)


@overload
def load_any_run(path: str | Path) -> Run: ...


@overload
def load_any_run(path: str | Path, kind: type[AnyRun]) -> AnyRun: ...


def load_any_run(path: str | Path, kind: type[Run] = Run) -> Run:
    """Read the run in a folder that `run` wrote, or in a record that `record pack` wrote."""
    path = user_path(path)
    return _open_record(path, kind) if path.is_file() else kind(path)


def with_runs_inside(paths: Iterable[Path]) -> list[Path]:
    """Return paths of runs and records; a folder that is not a run is replaced by the runs and records in it, sorted by
    name.
    """
    found = []
    for path in (user_path(each) for each in paths):
        if not path.is_dir() or (path / "manifest.json").exists():
            found.append(path)
            continue
        inside = [each for each in sorted(path.iterdir()) if (each / "manifest.json").is_file() or is_record(each)]
        if not inside:
            raise RunError(f"{path} contains no run or record; give a run folder, or a folder that contains runs")
        found += inside
    return found


def is_record(path: str | Path) -> bool:
    """Return whether a path looks like a record: a zip file whose first entry is `record.json`."""
    if not os.path.isfile(path):  # reading a pipe would block, or take the bytes from the next reader
        return False
    try:
        with open(path, "rb") as file:
            head = file.read(64)
    except OSError:
        return False
    return head.startswith(b"PK\x03\x04") and head[30:].startswith(b"record.json")


def _open_record(path: Path, kind: type[AnyRun]) -> AnyRun:
    from .container import read_file
    from .read import Reader
    from .verify import verified

    if not is_record(path):
        raise RunError(f"{path} is neither a run folder nor a record; give one written by 'run' or 'record pack'")
    reader = Reader(read_file(path), str(path))
    verified(reader)
    folder = Path(mkdtemp(prefix="robustflow-"))
    try:
        reader.extract(folder)
        run = kind(folder)
        run.record = reader.sha256
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(run, shutil.rmtree, folder, True)
    return run
