"""A run folder: its rows on disk, the lock for writing, and the list of existing rows.

manifest.json      what ran: identity, versions, machine, selection
rows/*.parquet     shards: NAME.DIGEST.parquet, written once
clean/*.npy        during a run: clean flows of samples in progress (`trust.write_array`)
attacks/*.npy      perturbations that attacks were trained to make (`trust.write_array`)
summary.json, report.html
examples/          pictures of the worst and the median sample
source.json        where model and data were on this machine

The digest of a shard is the BLAKE2b hash of the file, 32 hexadecimal digits, so that damage is always detected. Its
name is SAMPLE.CORRUPTION.SEVERITIES, or "pack" after merging.
"""

from __future__ import annotations

import io
import os
import re
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import polars as pl
from filelock import FileLock, Timeout

from ..core.errors import RunError, UsageError
from ..core.files import TEMPORARY, digest_of_bytes, digest_of_value, make_folder, write_bytes
from ..core.paths import refuse_links, user_path
from ..metrics.rows import ROW_KEY, ROW_SCHEMA, rows_frame
from .manifest import LARGEST_MANIFEST, Cell, Manifest
from .trust import read_document

if TYPE_CHECKING:
    from .plan import Unit

PACK = "pack"
_SUFFIX = ".parquet"
_DIGEST = re.compile(r"\.([0-9a-f]{32})$")
_RECOMPUTE = "delete it and run the same command again: only its rows are recomputed"
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


_reader: int | None = None
"""The first process that has listed shards."""


def list_shards(folder: Path) -> list[Path]:
    """Return the shards of a folder, by name; listed again until nothing changes, because a writer may be merging.
    Raise in a fork of a process that has used Polars, because its threads do not survive, and the fork would hang."""
    global _reader
    _reader = _reader or os.getpid()
    if _reader != os.getpid():
        raise UsageError(
            "this process was forked from one that has run or read an evaluation, and cannot use its threads; start "
            'it in another way, for example with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))'
        )
    before: list[Path] | None = None
    for _ in range(20):
        now = sorted(path for path in folder.glob(f"*{_SUFFIX}") if not path.name.startswith("."))
        if now == before:
            break
        before = now
    return now


def shard_name(path: Path) -> str:
    """Return a shard's file name without digest and suffix."""
    return _DIGEST.sub("", path.name.removesuffix(_SUFFIX))


def write_shard(folder: Path, name: str, rows: pl.DataFrame) -> Path:
    """Write rows as one shard, completely and durably or not at all, and return its path."""
    file = io.BytesIO()
    rows.write_parquet(file)
    data = file.getvalue()
    path = folder / f"{name}.{digest_of_bytes(data)}{_SUFFIX}"
    write_bytes(path, data)
    return path


def read_shard(path: Path, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Read the rows of one shard, or some of their columns."""
    data = _bytes(path)
    try:
        rows = pl.read_parquet(io.BytesIO(data), columns=None if columns is None else list(columns))
    except (Exception, pl.exceptions.PanicException) as error:  # PanicException is not an Exception
        raise RunError(path, f"damaged ({type(error).__name__}); {_RECOMPUTE}") from error
    _check_schema(path, rows.schema, columns)
    return rows


def _bytes(path: Path) -> bytes:
    """Read a shard, and compare it with the digest in its name."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise  # merged in the meantime
    except OSError as error:
        raise RunError(path, f"cannot be read ({error.strerror}); check its permissions") from error
    digest = _DIGEST.search(path.name.removesuffix(_SUFFIX))
    if digest is None or digest[1] != digest_of_bytes(data):
        raise RunError(path, f"damaged: its bytes do not match the digest in its name; {_RECOMPUTE}")
    return data


def _check_schema(path: Path, schema: Mapping[str, Any], columns: Sequence[str] | None = None) -> None:
    if pl.Schema(schema) != pl.Schema({name: ROW_SCHEMA[name] for name in columns or ROW_SCHEMA}):
        raise RunError(path, "has different columns than this version writes; choose another folder with --output")


def read_shards(
    paths: Iterable[Path], columns: Sequence[str] | None = None, corruption: str | None = None
) -> pl.DataFrame:
    """Read the rows of some shards, without duplicates, sorted by their keys."""
    parts = {}
    for path in paths:
        rows = read_shard(path, columns)
        parts[path] = rows if corruption is None else rows.filter(corruption=corruption)
    if not parts:
        return rows_frame([]).select(columns or list(ROW_SCHEMA))
    rows = pl.concat(parts.values()).sort(ROW_KEY)
    if not rows.select(pl.struct(ROW_KEY).is_duplicated().any()).item():
        return rows
    rows = rows.unique(maintain_order=True)
    contradictory = rows.filter(pl.struct(ROW_KEY).is_duplicated()).select(ROW_KEY)
    if contradictory.is_empty():
        return rows
    key = contradictory.row(0, named=True)
    here = pl.all_horizontal(pl.col(name).eq_missing(pl.lit(value)) for name, value in key.items())
    holders = [str(path) for path, part in parts.items() if not part.filter(here).is_empty()]
    cell = f"sample '{key['sample']}', {key['corruption']} severity {key['severity']}"
    if len(holders) == 1:
        raise RunError(holders[0], f"has two different rows of {cell}; {_RECOMPUTE}")
    raise RunError(
        holders[0],
        f"differs from {holders[1]} in {cell}: the shards of two runs were mixed; delete the one that does not belong "
        "here",
    )


def scan_shards(paths: Sequence[Path]) -> pl.LazyFrame:
    """Scan rows lazily, in the order of the shards; rows that are in two shards occur twice."""
    for path in paths:
        _check_schema(path, pl.read_parquet_schema(io.BytesIO(_bytes(path))))
    return pl.scan_parquet(list(paths)) if paths else rows_frame([]).lazy()


def shards_digest(paths: Iterable[Path]) -> str:
    """Return a hash of some intact shards, in the given order."""
    return digest_of_value([path.name for path in paths if _bytes(path)], size=16)


def merge_shards(paths: Sequence[Path]) -> None:
    """Merge shards into one, which is durably written before the others are removed, so that no row is lost in a crash
    or for a concurrent reader."""
    merged = write_shard(paths[0].parent, PACK, read_shards(paths))
    for path in paths:
        if path != merged:
            path.unlink(missing_ok=True)


def cells_of(paths: Sequence[Path]) -> tuple[set[Cell], list[Path]]:
    """Return the cells of some shards, and the shards that share a cell after a crash during merging."""
    if not paths:
        return set(), []
    rows = pl.concat(read_shard(path, ROW_KEY).with_columns(shard=pl.lit(i)) for i, path in enumerate(paths))
    same: dict[str, str] = {}  # one object per distinct string: a large run has millions of rows
    keys = rows.select(ROW_KEY).iter_rows()
    cells: set[Cell] = {(same.setdefault(k, k), same.setdefault(c, c), s) for k, c, s in keys}
    if len(cells) == rows.height:
        return cells, []
    twice = rows.filter(pl.struct(ROW_KEY).is_duplicated())["shard"].unique().sort()
    return cells, [paths[i] for i in twice]
