"""An on-disk cache of folders with a size limit; the least recently used folders are removed first."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from filelock import FileLock

from ..atomic import make_folder
from ..digest import digest_of_value, quick_digest_of_file
from ..errors import DataError

T = TypeVar("T")

_DIGEST = ".digest"


class FolderCache:
    """A cache of named folders in `root`, at most `limit` bytes in total, shared between processes."""

    def __init__(self, root: Path, limit: int) -> None:
        self.root = root
        self.limit = limit

    def use(self, name: str, make: Callable[[Path], object], read: Callable[[Path], T]) -> T:
        """Read the entry `name`; create it first if it does not exist."""
        make_folder(self.root)
        entry = self.root / name
        while True:
            with locked(self.root / f".{name}.lock"):
                if not _is_intact(entry):
                    shutil.rmtree(entry, ignore_errors=True)
                    self._make(entry, make)
            with locked(self.root / ".all.lock"):
                if entry.is_dir():  # another process may have evicted the entry in the meantime
                    os.utime(entry)
                    return read(entry)

    def _make(self, entry: Path, make: Callable[[Path], object]) -> None:
        temporary = self.root / f".making-{entry.name}"
        shutil.rmtree(temporary, ignore_errors=True)  # left behind by a killed process
        try:
            make(temporary)
            (temporary / _DIGEST).write_text(_digest(temporary))
            temporary.rename(entry)
        except OSError as error:
            raise DataError(f"cannot write {entry}: {error.strerror or error}; is the disk full?") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        self._evict(keep=entry)

    def _evict(self, keep: Path) -> None:
        with locked(self.root / ".all.lock"):
            entries = sorted((e for e in self.entries() if e != keep), key=lambda e: e.stat().st_mtime)
            used = _size(keep) + sum(map(_size, entries))
            for entry in entries:
                if used <= self.limit:
                    return
                used -= _size(entry)
                shutil.rmtree(entry, ignore_errors=True)

    def entries(self) -> list[Path]:
        if not self.root.is_dir():
            return []
        return sorted(entry for entry in self.root.iterdir() if entry.is_dir() and not entry.name.startswith("."))


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file while the context is active; wait while another process holds it."""
    try:
        # The operating system releases this lock when the process dies, whereas a plain lock file remains after a kill.
        lock = FileLock(path, fallback_to_soft=False)
        lock.acquire()
    except OSError as error:
        raise DataError(f"cannot write {path.parent}: {error.strerror or error}; check its owner") from error
    try:
        yield
    finally:
        lock.release()


def _is_intact(entry: Path) -> bool:
    try:
        return (entry / _DIGEST).read_text() == _digest(entry)
    except (OSError, ValueError):
        return False


def _digest(folder: Path) -> str:
    """Hash the names and contents of a folder's files (top level only)."""
    files = sorted(path for path in folder.iterdir() if path.name != _DIGEST)
    return digest_of_value([(path.name, quick_digest_of_file(path)) for path in files], size=16)


def _size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
