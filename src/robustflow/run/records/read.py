"""Read a record file: every property of `Reader` trusts only what the previous ones have checked, or raises."""

from __future__ import annotations

import hashlib
import json
import shutil
import weakref
from functools import cached_property
from pathlib import Path
from tempfile import mkdtemp
from typing import TypeVar

import polars as pl
from pydantic import ValidationError

from ...core.errors import DataError, first_misfit
from ...core.files import json_bytes, write_bytes
from ...core.text import plain
from ...corruptions.api import STREAM_VERSION
from ..costs import PROFILE, RunCost
from ..manifest import Manifest
from ..run import Run
from ..store import PACK, write_shard
from ..trust import document_bytes, parse_document
from .format import MOST_ROWS, Record, check_text, read_container, read_file, rows_from_text, texts
from .row_rules import check_rules

AnyRun = TypeVar("AnyRun", bound=Run)


class Reader:
    """Reader of one record, a file or its bytes."""

    def __init__(self, source: Path | bytes, name: str = "") -> None:
        self._source = source
        self.name = name or str(source)

    @cached_property
    def data(self) -> bytes:
        return self._source if isinstance(self._source, bytes) else read_file(self._source)

    @cached_property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()

    @cached_property
    def entries(self) -> dict[str, bytes]:
        """The entries of the zip file: exactly those of a record, uncompressed."""
        return read_container(self.data, self.name)

    @cached_property
    def facts(self) -> Record:
        """The content of `record.json`."""
        data = self.entries["record.json"]
        try:
            facts = Record.model_validate_json(data)
        except ValidationError as error:
            why = f"{plain(first_misfit(error), 200)}; use the version that packed it"
            raise DataError("record.json", why) from error
        _check_json("record.json", data, json_bytes(facts.model_dump()))
        return facts

    @cached_property
    def plan(self) -> Manifest:
        """The manifest, which a record can contain, and whose cells fit into memory."""
        name, data = "manifest.json", self.entries["manifest.json"]
        plan = parse_document(Manifest, data, name, "use the version that packed it")
        if not any(part.corruptions or part.attacks for part in plan.planned):
            raise DataError(name, "no corruption or attack of a sample is planned")
        if (planned := sum(part.count() for part in plan.planned)) > MOST_ROWS:
            raise DataError(name, f"{planned} rows are planned; the limit for a record is {MOST_ROWS}")
        _check_json(name, data, plan.shareable().document())
        if (streams := plan.identity.frames.streams) != STREAM_VERSION:
            why = f"has frames of version {streams}, not {STREAM_VERSION}; use the version that packed it"
            raise DataError(name, why)
        if PROFILE in self.entries:
            cost = parse_document(RunCost, self.entries[PROFILE], PROFILE, RunCost.remedy())
            _check_json(PROFILE, self.entries[PROFILE], document_bytes(cost.model_dump()))
            if cost.run != plan.identity_digest:
                raise DataError(PROFILE, "belongs to a different run")
        return plan

    @property
    def attacks(self) -> tuple[str, ...]:
        return self.plan.attacks

    @cached_property
    def frame(self) -> pl.DataFrame:
        """The rows: unique, with the right types, printable text and numbers in range."""
        rows = rows_from_text(self.entries["rows.csv"])
        check_rules(rows)
        return rows

    def open(self, kind: type[AnyRun]) -> AnyRun:
        """Return the run, in a temporary folder that is deleted with it: fixed file names, rows serialized again."""
        folder = Path(mkdtemp(prefix="robustflow-"))
        try:
            (folder / "rows").mkdir()
            for name in self.entries.keys() & {"manifest.json", PROFILE}:
                write_bytes(folder / name, self.entries[name])
            write_shard(folder / "rows", PACK, self.frame)
            run = kind(folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        run.record = self.sha256
        weakref.finalize(run, shutil.rmtree, folder, True)
        return run


def _check_json(name: str, data: bytes, written: bytes) -> None:
    """Raise if a JSON entry differs from what `record pack` writes, or contains text that cannot be displayed."""
    for where, text in texts(json.loads(data)):
        check_text(text, f"{name}, {where or 'a name'}")
    if written != data:
        raise DataError(
            name,
            "not as 'robustflow record pack' writes it (order of keys, notation of numbers, fields that a record "
            "omits); pack the run again",
        )
