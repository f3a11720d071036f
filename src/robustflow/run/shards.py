"""Store rows in shards: Parquet files that are written once.

A shard is named NAME.DIGEST.parquet, where DIGEST is the BLAKE2b hash of the file, 32 hexadecimal digits, so that
damage is always detected. NAME is SAMPLE.CORRUPTION.SEVERITIES, or "pack" after merging.
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
_SUFFIX = ".parquet"
_DIGEST = re.compile(r"\.([0-9a-f]{32})$")
_DAMAGED = "delete it and run the same command again: only its rows are recomputed"


def list_shards(folder: Path) -> list[Path]:
    """Return the shards of a folder, by name; listed again until nothing changes, because a writer may be merging."""
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
        raise RunError(path, f"damaged ({type(error).__name__}); {_DAMAGED}") from error
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
        raise RunError(path, f"damaged: its bytes do not match the digest in its name; {_DAMAGED}")
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
    one, other, *_ = (str(path) for path, part in parts.items() if not part.filter(**key).is_empty())
    raise RunError(
        one,
        f"differs from {other} in sample '{key['sample']}', {key['corruption']} severity {key['severity']}: the shards "
        "of two runs were mixed; delete the one that does not belong here",
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
