"""A run folder: its rows on disk, the lock for writing, and the list of existing rows.

manifest.json      what ran: identity, versions, machine, selection
rows/*.parquet     shards, written once, each with a digest in its name (`shards`)
clean/*.npy        during a run: clean flows of samples in progress (`trust.write_array`)
attacks/*.npy      perturbations that attacks were trained to make (`trust.write_array`)
summary.json, report.html
examples/          pictures of the worst and the median sample
source.json        where model and data were on this machine
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import polars as pl
from filelock import FileLock, Timeout

from ..core.errors import RunError
from ..core.files import TEMPORARY, digest_of_bytes, make_folder, write_bytes
from ..core.paths import refuse_links, user_path
from ..metrics.rows import rows_frame
from .cells import Cell
from .manifest import LARGEST_MANIFEST, Manifest
from .shards import (
    cells_of,
    list_shards,
    merge_shards,
    read_shard,
    read_shards,
    scan_shards,
    shard_name,
    shards_digest,
    write_shard,
)
from .trust import read_document

if TYPE_CHECKING:
    from .plan import Unit

_MANY_SHARDS = 64
"""Number of small shards to merge into one."""
_SMALL_SHARD = 2**20
"""Size in bytes below which shards are merged: about 10,000 rows."""
_INSIDE = ("rows", "clean", "attacks", "examples")
"""Subfolders of a run's folder."""
_UNUSABLE = "restore it from a backup, use the version that wrote it, or choose another folder with --output"
_RETRIES = 1000
"""Maximum number of times that a reader lists the shards again while another process writes."""

T = TypeVar("T")


class RunFolder:
    """The folder of one run. Call `lock()` before writing; reading needs no lock."""

    def __init__(self, path: str | Path) -> None:
        self.path = user_path(path)
        self.rows_folder = self.path / "rows"
        self.clean_folder = self.path / "clean"
        self.manifest_path = self.path / "manifest.json"
        self.lock_path = self.path / ".lock"
        self._lock: FileLock | None = None
        self._lock_inode: tuple[int, int] | None = None

    def lock(self) -> None:
        """Create the folder, lock it until this process ends, and remove half-written files of a killed run."""
        refuse_links(self.path, *_INSIDE)
        for folder in (self.path, self.rows_folder):
            make_folder(folder)
        # The operating system releases this lock; a simple lock file would remain after a killed run.
        lock = FileLock(self.lock_path, fallback_to_soft=False)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            why = "locked by another run; wait for it to end, or choose another folder with --output"
            raise RunError(self.path, why) from None
        except OSError as error:
            why = f"cannot be written ({error.strerror or error}); choose another folder with --output"
            raise RunError(self.path, why) from error
        self._lock, self._lock_inode = lock, _inode(self.lock_path)
        for path in (self.clean_folder, *self.path.glob(f"{TEMPORARY}*"), *self.path.glob(f"*/{TEMPORARY}*")):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        make_folder(self.clean_folder)

    def unlock(self) -> None:
        if self._lock is not None:
            shutil.rmtree(self.clean_folder, ignore_errors=True)
            self._lock.release()
            self._lock = None

    def _check_lock(self) -> None:
        """Raise if this path has become a different folder, to which a different run may write."""
        if _inode(self.lock_path) != self._lock_inode:
            raise RunError(
                self.path,
                "no longer locked: it was moved or deleted, or its .lock was; nothing more is written there; run the "
                "same command again once the folder is back, or choose another folder with --output",
            )

    def manifest(self) -> Manifest | None:
        """Read the manifest; None if the folder has no manifest yet."""
        if os.path.lexists(self.manifest_path):
            refuse_links(self.path, *_INSIDE)
        return read_document(Manifest, self.manifest_path, LARGEST_MANIFEST, _UNUSABLE)

    def write_manifest(self, manifest: Manifest) -> None:
        """Write the manifest atomically; raise a RunError if the folder is no longer locked."""
        self._check_lock()
        write_bytes(self.manifest_path, manifest.document())

    def write_rows(self, unit: Unit, rows: list[dict[str, Any]]) -> None:
        """Write one unit's rows as one shard; raise a RunError if the folder is no longer locked."""
        self._check_lock()
        severities = "".join(map(str, unit.severities))
        write_shard(self.rows_folder, f"{_slug(unit.key)}.{_slug(unit.corruption)}.{severities}", rows_frame(rows))

    def finish_sample(self, key: str) -> None:
        """Delete the clean flow of a finished sample, and merge the small shards if there are many."""
        self.clean_path(key).unlink(missing_ok=True)
        self.pack(_MANY_SHARDS)

    def drop_samples(self, keys: Collection[str]) -> None:
        """Remove the rows and clean flows of some samples."""
        for path in list_shards(self.rows_folder):
            rows = read_shard(path)
            remaining = rows.filter(~pl.col("sample").is_in(list(keys)))
            if remaining.height < rows.height:
                if remaining.height:
                    write_shard(self.rows_folder, shard_name(path), remaining)
                path.unlink()

    def pack(self, at_least: int = 2) -> None:
        """Merge small shards into one, if there are `at_least` of them."""
        self._check_lock()
        small = [path for path in list_shards(self.rows_folder) if path.stat().st_size < _SMALL_SHARD]
        if len(small) >= at_least:
            merge_shards(small)

    def tidy(self) -> set[Cell]:
        """Return the existing cells; remove rows that occur twice after a crash between merging and removing."""
        cells, twice = cells_of(list_shards(self.rows_folder))
        if twice:
            merge_shards(twice)
        return cells

    def rows(self, columns: Sequence[str] | None = None, corruption: str | None = None) -> pl.DataFrame:
        """Read all rows, sorted by sample, corruption and severity; empty if no unit is finished."""
        return self._read(lambda shards: read_shards(shards, columns, corruption))

    def scan(self) -> pl.LazyFrame:
        """Scan all rows lazily; see `scan_shards`."""
        return scan_shards(list_shards(self.rows_folder))

    def digest(self) -> str:
        """Return a hash of the shards on disk, which are intact: equal digests mean equal rows. No row is decoded."""
        return self._read(shards_digest)

    def _read(self, read: Callable[[list[Path]], T]) -> T:
        for _ in range(_RETRIES):
            try:
                return read(list_shards(self.rows_folder))
            except FileNotFoundError as error:  # merged between listing and reading, so list again
                gone = error.filename
        raise RunError(gone, "listed but missing; run the command again when no other process is writing to its folder")

    def clean_path(self, key: str) -> Path:
        """Return the path at which the clean flow of a sample is stored until the sample is finished."""
        return self.clean_folder / f"{_slug(key)}.npy"

    def pattern_path(self, attack: str, severity: int) -> Path:
        """Return the path at which the perturbation of a trained attack is stored."""
        return self.path / "attacks" / f"{_slug(attack)}.{severity}.npy"


def _inode(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _slug(text: str) -> str:
    """Return a readable file name that is unique to the given text."""
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '_', text)[-48:]}-{digest_of_bytes(text.encode(), size=4)}"
