"""Pack a run folder into a single file, read a run from a folder or such a record, and keep a folder of records, from
which a leaderboard in a git repository is generated: FOLDER/records/<first 16 digits of the SHA-256>.robustflow.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, overload

import polars as pl
from pydantic import ValidationError

from ...core.errors import DataError, RobustFlowError, RunError, UsageError
from ...core.files import json_bytes, make_folder, write_bytes
from ...core.paths import user_path
from ...core.text import counted, plain
from ..costs import PROFILE, RunCost
from ..run import Run
from ..trust import document_bytes
from .format import Record, check_text, container_bytes, rows_to_text, shareable_manifest
from .read import AnyRun, Reader
from .verify import verified, verify_read

SUFFIX = ".robustflow"


def pack(
    run: Run,
    path: str | Path | None = None,
    *,
    overwrite: bool = False,
    partial: bool = False,
    keep_paths: bool = False,
    **texts: str,
) -> Path:
    """Write a run as a record; `docs/records.md` describes its contents. The same run and texts always produce the same
    bytes.
    """
    data = record_bytes(run, partial=partial, keep_paths=keep_paths, **texts)
    target = user_path(path) if path is not None else Path(run.path.absolute().name + SUFFIX)
    if target.suffix != SUFFIX:
        raise UsageError(target, f"the name of a record must end in {SUFFIX}")
    verification = verify_read(Reader(data, str(target)))
    if not verification.ok:
        raise RunError(run.path, f"not packed, because it would not verify: {verification.first_failure()}")
    if not overwrite and target.exists() and _run_of(target) != run.manifest.identity_digest:
        raise RunError(
            target, "exists and is not a record of this run; choose a different file with -o, or give --overwrite"
        )
    write_bytes(target, data)
    return target


def _run_of(path: Path) -> str | None:
    """Return the digest of the run in a record file, or None if the file is not a record."""
    try:
        return Reader(path).plan.identity_digest
    except DataError:
        return None


def record_bytes(run: Run, *, partial: bool = False, keep_paths: bool = False, **texts: str) -> bytes:
    """Return the bytes of the file that `record pack` writes; `texts` are the author, link and description."""
    stated = {name: " ".join(text.split()) for name, text in texts.items()}
    for name, text in stated.items():
        check_text(text, f"--{name}")
    manifest = shareable_manifest(run.manifest, keep_paths)
    attacked = run.attack_rows.filter(pl.col("corruption").is_in(manifest.attacks))
    missing = sum(cells.count for cells in run.measured.missing)
    missing += sum(part.count() - part.count(attacks=False) for part in manifest.planned) - attacked.height
    if missing and not partial:
        raise RunError(
            run.path,
            f"not finished: {counted(missing, 'row')} missing; run the same command again, or pack the unfinished run "
            "with --partial",
        )
    entries = {"manifest.json": manifest.document(), "rows.csv": rows_to_text(pl.concat([run.rows, attacked]))}
    if (cost := RunCost.read(run)) is not None:
        entries[PROFILE] = document_bytes(cost.model_dump())
    try:
        record = Record.model_validate({"complete": not missing, **stated})
    except ValidationError as error:
        raise DataError(f"--{error.errors()[0]['loc'][0]}", error.errors()[0]["msg"]) from error
    return container_bytes({"record.json": json_bytes(record.model_dump()), **entries})


@overload
def load_any_run(path: str | Path) -> Run: ...


@overload
def load_any_run(path: str | Path, kind: type[AnyRun]) -> AnyRun: ...


def load_any_run(path: str | Path, kind: type[Run] = Run) -> Run:
    """Read the run in a folder that `run` wrote, or in a record that `record pack` wrote."""
    path = user_path(path)
    if not path.is_file():
        return kind(path)
    if path.suffix != SUFFIX:
        raise RunError(path, "neither a run folder nor a record; give one written by 'run' or 'record pack'")
    reader = Reader(path)
    verified(reader)
    return reader.open(kind)


def with_runs_inside(paths: Iterable[Path]) -> list[Path]:
    """Return paths of runs and records; a folder of runs is replaced by those in it, sorted by name."""
    found = []
    for path in (user_path(each) for each in paths):
        if not path.is_dir() or (path / "manifest.json").exists():
            found.append(path)
            continue
        inside = [
            each
            for each in sorted(path.iterdir())
            if (each / "manifest.json").is_file() or (each.suffix == SUFFIX and each.is_file())
        ]
        if not inside:
            raise RunError(path, "contains no run or record; give a run folder, or a folder that contains runs")
        found += inside
    return found


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
