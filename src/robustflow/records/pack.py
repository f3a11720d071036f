"""Pack a run folder into a single file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from ..atomic import json_bytes, write_bytes
from ..errors import DataError, RunError, UsageError
from ..layout import user_path
from ..runs.costs import PROFILE, read_cost
from ..sealed import sealed
from .container import container_bytes, read_file
from .contents import PackedEntry, Record, parsed, shareable_manifest
from .read import Reader
from .rows_text import rows_to_text
from .text import check_text
from .verify import verify_read

if TYPE_CHECKING:
    from ..runs.run import Run

SUFFIX = ".robustflow"


def pack(
    run: Run,
    path: str | Path | None = None,
    *,
    author: str = "",
    link: str = "",
    description: str = "",
    partial: bool = False,
    keep_paths: bool = False,
    overwrite: bool = False,
) -> Path:
    """Write a run as a record; `docs/records.md` describes its contents. The same run and texts always produce the same
    bytes.
    """
    data = record_bytes(run, author=author, link=link, description=description, partial=partial, keep_paths=keep_paths)
    target = user_path(path) if path is not None else Path(run.path.absolute().name + SUFFIX)
    if target.suffix != SUFFIX:
        raise UsageError(f"{target}: the name of a record must end in {SUFFIX}")
    verification = verify_read(Reader(data, str(target)))
    if not verification.ok:
        raise RunError(f"{run.path} cannot be packed, because it would not verify: {verification.first_failure()}")
    if not overwrite and target.exists() and _run_of(target) != run.manifest.identity_digest:
        raise RunError(
            f"{target} exists and is not a record of this run; choose a different file with -o, or give --overwrite"
        )
    write_bytes(target, data)
    return target


def _run_of(path: Path) -> str | None:
    """Return the digest of the run in a record file, or None if the file is not a record."""
    reader = Reader(read_file(path), str(path))
    try:
        reader.container()
        reader.record()
    except DataError:
        return None
    return reader.facts.run


def record_bytes(
    run: Run,
    *,
    author: str = "",
    link: str = "",
    description: str = "",
    partial: bool = False,
    keep_paths: bool = False,
) -> bytes:
    """Return the bytes of the file that `record pack` writes."""
    manifest = shareable_manifest(run.manifest, keep_paths)
    attacked = run.attack_rows.filter(pl.col("corruption").is_in(manifest.attacks))
    missing = sum(len(units.samples) for units in run.summary.missing)
    missing += sum(len(list(part.attacked())) for part in manifest.planned) - attacked.height
    if missing and not partial:
        raise RunError(
            f"{run.path} is not finished: {missing} rows are missing; run the same command again to continue, or "
            "pack the unfinished run with --partial"
        )
    entries = {
        "manifest.json": json_bytes(manifest.record()),
        "rows.csv": rows_to_text(pl.concat([run.rows, attacked])),
        "summary.json": json_bytes(run.document()),
    }
    cost = read_cost(run)
    if cost is not None:
        entries[PROFILE] = json_bytes(sealed(cost.model_dump()))
    texts = {"author": author, "link": link, "description": description}
    stated = {name: " ".join(text.split()) for name, text in texts.items()}
    for name, text in stated.items():
        check_text(text, f"--{name}")
    packed = {
        name: PackedEntry(bytes=len(data), sha256=hashlib.sha256(data).hexdigest()) for name, data in entries.items()
    }
    facts = {"run": run.manifest.identity_digest, "complete": not missing, "entries": packed, **stated}
    record = parsed(Record.model_validate, facts, "the record")
    return container_bytes({"record.json": json_bytes(record.model_dump()), **entries})
