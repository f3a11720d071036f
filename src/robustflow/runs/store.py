"""A run folder: the rows on disk, who may write them, and what is already there.

manifest.json      what ran: identity, versions, machine, selection
rows/*.parquet     one shard per unit, written once, by rename
clean/*.npy        clean flows of samples that are not finished yet
summary.json, report.html
examples/           pictures of the worst and the median sample
source.json        where model and data lay on this machine
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..atomic import TEMPORARY, make_folder, write_bytes, write_json
from ..errors import RunError
from ..metrics.rows import LATER_COLUMNS, ROW_KEY, ROW_SCHEMA, rows_frame
from ..sample import Flow
from .plan import Cell, Unit

MANIFEST_SCHEMA = 1


class RunFolder:
    """One run's folder. `lock()` before writing; reading needs no lock."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).expanduser()
        self._lock: int | None = None

    @property
    def rows_folder(self) -> Path:
        return self.path / "rows"

    @property
    def manifest_path(self) -> Path:
        return self.path / "manifest.json"

    def lock(self) -> None:
        """Create the folder and hold it until this process ends; clear what a killed run left half-written."""
        for folder in (self.path, self.rows_folder, self.path / "clean"):
            make_folder(folder)
        try:
            self._lock = os.open(self.path / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.unlock()
            raise RunError(
                f"{self.path} is held by another run; wait for it to end, or choose another folder with --output"
            ) from None
        except OSError as error:
            raise RunError(
                f"cannot write {self.path}: {error.strerror}; choose another folder with --output"
            ) from error
        for left in list(self.path.rglob(f"{TEMPORARY}*")):
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)

    def unlock(self) -> None:
        """Let go of the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def manifest(self) -> dict[str, Any] | None:
        """The manifest, or None in a folder that has none yet.

        Raises:
            RunError: it is not ours, damaged, or of another schema.
        """
        try:
            found = json.loads(self.manifest_path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise RunError(
                f"{self.manifest_path} cannot be read ({error}); choose another folder with --output"
            ) from error
        schema = found.get("schema") if isinstance(found, dict) else None
        if schema != MANIFEST_SCHEMA:
            raise RunError(
                f"{self.path} was written with run schema {schema}, this version reads {MANIFEST_SCHEMA}; "
                "choose another folder with --output, or use the version that wrote it"
            )
        return dict(found)

    def write_manifest(self, manifest: dict[str, Any]) -> None:
        """Write the manifest atomically."""
        write_json(self.manifest_path, {"schema": MANIFEST_SCHEMA, **manifest})

    def write_rows(self, unit: Unit, rows: list[dict[str, Any]]) -> None:
        """Write one unit's rows as one shard."""
        _write_shard(self.rows_folder / f"{_shard_name(unit)}.parquet", rows_frame(rows))

    def merge(self, key: str) -> None:
        """Put the shards of a finished sample into one: a file per unit is much to open, and memory, for a reader.

        The merged shard is there before the others go, so a reader finds every row at least once.
        """
        merged = self.rows_folder / f"{_slug(key)}.parquet"
        shards = self._shards(f"{_slug(key)}.")
        _write_shard(merged, _read_shards(shards))
        for path in shards:
            if path != merged:
                path.unlink(missing_ok=True)

    def rows(self) -> pl.DataFrame:
        """All rows, sorted by sample, corruption and severity; empty where nothing is finished.

        Raises:
            RunError: a shard is damaged, or of another schema.
        """
        while True:
            paths = self._shards()
            try:
                return _read_shards(paths)
            except FileNotFoundError:  # merged between listing and reading: list again
                continue

    def _shards(self, prefix: str = "") -> list[Path]:
        paths = self.rows_folder.glob("*.parquet")
        return sorted(path for path in paths if path.name.startswith(prefix) and not path.name.startswith(TEMPORARY))

    def cells(self) -> set[Cell]:
        """What is already there."""
        return set(self.rows().select(ROW_KEY).iter_rows())

    def clean_path(self, key: str) -> Path:
        """Where the clean flow of a sample waits until the sample is finished."""
        return self.path / "clean" / f"{_slug(key)}.npy"

    def drop_clean(self) -> None:
        """Let go of all clean flows."""
        for path in (self.path / "clean").glob("*.npy"):
            path.unlink(missing_ok=True)


def _write_shard(path: Path, rows: pl.DataFrame) -> None:
    shard = io.BytesIO()
    rows.write_parquet(shard)
    write_bytes(path, shard.getvalue())


def _read_shards(paths: list[Path]) -> pl.DataFrame:
    """The rows of some shards, each once, in the order of their keys."""
    if not paths:
        return rows_frame([])
    try:
        rows = pl.read_parquet(paths, glob=False)
    except (pl.exceptions.PolarsError, OSError):
        for path in paths:  # one of them is the reason: say which
            _check_shard(path)
        rows = pl.concat([_with_later_columns(pl.read_parquet(path, glob=False)) for path in paths])
    rows = _with_later_columns(rows)
    if rows.schema != pl.Schema(ROW_SCHEMA):
        raise RunError(f"{paths[0]} has other columns than this version writes; choose another folder with --output")
    return rows.unique(subset=ROW_KEY, keep="any").sort(ROW_KEY)


def _with_later_columns(rows: pl.DataFrame) -> pl.DataFrame:
    absent = [name for name in LATER_COLUMNS if name not in rows.columns]
    return rows.with_columns(pl.lit(None, LATER_COLUMNS[name]).alias(name) for name in absent)


def _check_shard(path: Path) -> None:
    try:
        schema = _with_later_columns(pl.read_parquet(path, glob=False)).schema
    except FileNotFoundError:
        raise
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RunError(f"{path} is damaged ({type(error).__name__}); delete it and run again") from error
    if schema != pl.Schema(ROW_SCHEMA):
        raise RunError(f"{path} has other columns than this version writes; choose another folder with --output")


def write_clean(path: Path, flow: Flow) -> None:
    """Keep a clean flow for the units of its sample that are still to come."""
    file = io.BytesIO()
    np.save(file, flow, allow_pickle=False)
    write_bytes(path, file.getvalue())


def read_clean(path: Path) -> Flow | None:
    """A clean flow kept earlier, or None."""
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float32)
    except FileNotFoundError:
        return None


def _shard_name(unit: Unit) -> str:
    severities = "".join(str(severity) for severity in unit.severities)
    return f"{_slug(unit.key)}.{_slug(unit.corruption)}.{severities}"


def _slug(text: str) -> str:
    """A file name for any text: readable, and different for different texts."""
    digest = hashlib.blake2b(text.encode(), digest_size=4).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '_', text)[-48:]}-{digest}"
