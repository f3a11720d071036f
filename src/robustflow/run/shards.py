"""Store rows in shards: Parquet files, each with the digest of its bytes in its name, so that damage is always
detected.

A shard is named NAME.DIGEST.parquet, where DIGEST is the BLAKE2b hash of the file, 32 hexadecimal digits. NAME
describes the content:

SAMPLE.CORRUPTION.SEVERITIES   one unit, as it was finished
SAMPLE                         all units of a sample
pack                           many samples
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import RunError
from ..core.files import digest_of_bytes, digest_of_value, write_bytes
from ..metrics.rows import ROW_KEY, ROW_SCHEMA, rows_frame
from .cells import Cell

PACK = "pack"
"""Name of a shard of many samples; differs from every sample's name, which ends in a hyphen and eight digits."""

_SUFFIX = ".parquet"
_DIGEST = re.compile(r"\.([0-9a-f]{32})$")


def list_shards(folder: Path) -> list[Path]:
    """Return the shards of a folder, by name."""
    before: list[Path] | None = None
    for _ in range(20):
        now = sorted(path for path in folder.glob(f"*{_SUFFIX}") if not path.name.startswith("."))
        if now == before:
            break
        before = now
    return now


def shard_name(path: Path) -> str:
    """Return the name of a shard's content: its file name without digest and suffix."""
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
    data = _checked_bytes(path)
    try:
        rows = pl.read_parquet(io.BytesIO(data), columns=None if columns is None else list(columns))
    except (Exception, pl.exceptions.PanicException) as error:  # PanicException is not an Exception
        raise _damaged(path, type(error).__name__) from error
    _check_schema(path, rows.schema, columns)
    return rows


def _checked_bytes(path: Path) -> bytes:
    data = _bytes(path)
    digest = _DIGEST.search(path.name.removesuffix(_SUFFIX))
    if digest is None:
        raise _damaged(path, "its name has no digest")
    if digest[1] != digest_of_bytes(data):
        raise _damaged(path, "its bytes have changed since it was written")
    return data


def _check_schema(path: Path, schema: Mapping[str, Any], columns: Sequence[str] | None = None) -> None:
    wanted = ROW_SCHEMA if columns is None else {name: ROW_SCHEMA[name] for name in columns}
    if pl.Schema(schema) != pl.Schema(wanted):
        raise RunError(f"{path} has different columns than this version writes; choose another folder with --output")


def read_shards(
    paths: Iterable[Path], columns: Sequence[str] | None = None, corruption: str | None = None
) -> pl.DataFrame:
    """Read the rows of some shards, without duplicates, sorted by their keys."""
    paths = list(paths)
    parts = []
    for path in paths:
        part = read_shard(path, columns)
        parts.append(part if corruption is None else part.filter(corruption=corruption))
    if not parts:
        return rows_frame([]).select(columns or list(ROW_SCHEMA))
    rows = pl.concat(parts).sort(ROW_KEY)
    if rows.select(pl.struct(ROW_KEY).is_duplicated().any()).item():
        rows = rows.unique(maintain_order=True)
        _refuse_contradictions(rows, paths, parts)
    return rows


def scan_shards(paths: Sequence[Path]) -> pl.LazyFrame:
    """Scan the rows of some shards lazily, a few columns at a time. Rows that are in two shards occur twice; the order
    is that of the shards.
    """
    for path in paths:
        _check_schema(path, pl.read_parquet_schema(io.BytesIO(_checked_bytes(path))))
    return pl.scan_parquet(list(paths)) if paths else rows_frame([]).lazy()


def shards_digest(paths: Iterable[Path]) -> str:
    """Return a hash of the bytes of some shards, in the given order."""
    return digest_of_value([digest_of_bytes(_bytes(path)) for path in paths], size=16)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from error


def merge_shards(paths: Sequence[Path], name: str) -> Path:
    """Merge shards into one, which is durably written before the others are removed, so that no row is lost in a crash
    or for a concurrent reader."""
    merged = write_shard(paths[0].parent, name, read_shards(paths))
    for path in paths:
        if path != merged:
            path.unlink(missing_ok=True)
    return merged


def cells_of(paths: Sequence[Path]) -> tuple[set[Cell], list[Path]]:
    """Return the cells of some shards, and the shards that share a cell with another shard after a crash during
    merging.
    """
    if not paths:
        return set(), []
    keys = [read_shard(path, ROW_KEY) for path in paths]
    rows = pl.concat(keys)
    same: dict[str, str] = {}  # one object per distinct string: a large run has millions of rows
    cells: set[Cell] = {(same.setdefault(k, k), same.setdefault(c, c), s) for k, c, s in rows.iter_rows()}
    if len(cells) == rows.height:
        return cells, []
    shared = rows.select(pl.struct(ROW_KEY).is_duplicated()).to_series()
    twice, start = [], 0
    for path, part in zip(paths, keys, strict=True):
        if shared[start : start + part.height].any():
            twice.append(path)
        start += part.height
    return cells, twice


def _refuse_contradictions(rows: pl.DataFrame, paths: list[Path], parts: list[pl.DataFrame]) -> None:
    repeated = rows.filter(pl.struct(ROW_KEY).is_duplicated())
    if repeated.is_empty():
        return
    key = dict(zip(ROW_KEY, repeated.select(ROW_KEY).row(0), strict=True))
    files = [str(path) for path, part in zip(paths, parts, strict=True) if not part.filter(**key).is_empty()]
    raise RunError(
        f"{' and '.join(files)} contain different rows for sample '{key['sample']}', {key['corruption']} severity "
        f"{key['severity']}: the shards of two runs were mixed; delete the one that does not belong here"
    )


def _damaged(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} is damaged ({why}); delete it and run the same command again: only its rows are recomputed"
    )
