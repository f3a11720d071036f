"""Read a record file step by step: each step trusts only what the previous ones have checked."""

from __future__ import annotations

import hashlib
from pathlib import Path

import polars as pl
from pydantic import ValidationError

from ...core.errors import DataError, first_misfit
from ...core.files import make_folder, write_bytes
from ...core.text import plain
from ...core.types import TRUTHS
from ...corruptions.api import STREAM_VERSION
from ...metrics.rows import ROW_KEY, ROW_SCHEMA, SIGNED
from ..costs import PROFILE, parse_cost
from ..manifest import Manifest
from ..shards import PACK, write_shard
from ..trust import parse_document
from .container import check_text, read_container, read_json
from .contents import MOST_ROWS, VERSION, Record, rows_from_text

_ALWAYS = (
    *("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width", "n_invalid", "n_all"),
    *("rcre_all_sum", "pred_magnitude_sum", "n_photometric", "photometric_sum", "photometric_still_sum"),
)
"""Columns without empty cells."""
_LARGEST_INT, _LARGEST_SUM = 2**53, 1e18
_LOWEST = {"attack_way_gone": -_LARGEST_SUM, **dict.fromkeys(SIGNED, -1.0)}
"""Lowest value of each column that may be negative."""


class Reader:
    """Reader of one record: `container`, `record`, `hashes`, `manifest` and `rows`, in this order. Every step returns a
    sentence that describes what it checked, or raises."""

    entries: dict[str, bytes]
    facts: Record
    plan: Manifest
    frame: pl.DataFrame

    def __init__(self, data: bytes, name: str) -> None:
        self._data = data
        self.name = name
        self.sha256 = hashlib.sha256(data).hexdigest()

    @property
    def attacks(self) -> tuple[str, ...]:
        """Return the attacks of the run; empty before the `manifest` step."""
        plan = getattr(self, "plan", None)
        return () if plan is None else plan.attacks

    def container(self) -> str:
        """Check that the file is a zip with exactly the entries of a record, uncompressed."""
        self.entries = read_container(self._data, self.name)
        return f"{len(self.entries)} entries, {len(self._data)} bytes"

    def record(self) -> str:
        """Check that this package can read the version of `record.json`."""
        data = self.entries["record.json"]
        version = read_json(data, "record.json").get("version")
        if version != VERSION:
            raise DataError("record.json", f"has version {plain(str(version), 20)}; this RobustFlow reads {VERSION}")
        try:
            self.facts = Record.model_validate_json(data)
        except ValidationError as error:
            raise DataError("record.json", plain(first_misfit(error), 200)) from error
        return f"version {VERSION}"

    def hashes(self) -> str:
        """Check that every entry has the hash listed in `record.json`."""
        found = {name: hashlib.sha256(data).hexdigest() for name, data in self.entries.items() if name != "record.json"}
        if self.facts.entries.keys() != found.keys():
            raise DataError("record.json", f"does not list exactly the entries of the file: {', '.join(found)}")
        for name, sha256 in found.items():
            if self.facts.entries[name] != sha256:
                raise DataError(name, "does not match its SHA-256 in record.json: it was changed or damaged")
        return f"{len(found)} entries"

    def manifest(self) -> str:
        """Check that `manifest.json` is whole, and that a record can contain all its rows."""
        data = self.entries["manifest.json"]
        read_json(data, "manifest.json")
        self.plan = parse_document(Manifest, data, "manifest.json", "use the version that packed it")
        if not any(part.corruptions or part.attacks for part in self.plan.planned):
            raise DataError("manifest.json", "no corruption or attack of a sample is planned")
        planned = sum(part.count() for part in self.plan.planned)
        if planned > MOST_ROWS:
            raise DataError("manifest.json", f"{planned} rows are planned; the limit for a record is {MOST_ROWS}")
        if self.plan.shareable().document() != data:
            raise DataError(
                "manifest.json",
                "has fields that a record must omit (environment.command, places, the version of the operating system, "
                "fields with their default values); pack the run again",
            )
        if (streams := self.plan.identity.frames.streams) != STREAM_VERSION:
            raise DataError(
                "manifest.json",
                f"has frames of version {streams}, but this RobustFlow makes version {STREAM_VERSION}; use the version "
                "that packed it",
            )
        digest = self.plan.identity_digest
        if digest != self.facts.run:
            raise DataError("record.json", f"states the run {self.facts.run}, but manifest.json is that of {digest}")
        if PROFILE in self.entries:
            read_json(self.entries[PROFILE], PROFILE)
            if parse_cost(self.entries[PROFILE], PROFILE).run != digest:
                raise DataError(PROFILE, "belongs to a different run")
        return f"run {digest}"

    def rows(self) -> str:
        """Check that rows have the right types, are unique, and contain only numbers in range and printable text."""
        frame = rows_from_text(self.entries["rows.csv"])
        if nulls := [name for name in _ALWAYS if frame[name].null_count()]:
            raise DataError("rows.csv", f"the column '{nulls[0]}' has empty cells")
        duplicates = frame.select(ROW_KEY).is_duplicated()
        if duplicates.any():
            sample, corruption, severity = frame.filter(duplicates).select(ROW_KEY).row(0)
            where = f"sample '{plain(sample)}', {plain(corruption)} severity {severity}"
            raise DataError("rows.csv", f"{where} appears twice")
        for column in ("sample", "group", "corruption"):
            for text in frame[column].unique():
                check_text(text, f"rows.csv, {column}")
                if not 0 < len(text) <= 500:
                    raise DataError("rows.csv", f"a {column} has {len(text)} characters; expected 1 to 500")
        for column in ("frames_digest", "truth_digest"):
            if not frame[column].drop_nulls().str.contains("^[0-9a-f]{32}$").all():
                raise DataError("rows.csv", f"a {column} does not consist of 32 hexadecimal digits")
        if not frame["truth"].is_in(TRUTHS).all():
            raise DataError("rows.csv", f"a row has an unknown truth; expected {' or '.join(TRUTHS)}")
        if not frame["truth_digest"].is_null().equals(frame["n_valid"].is_null()):
            raise DataError("rows.csv", "a row has a truth_digest but no pixels with ground truth, or vice versa")
        for column, kind in ROW_SCHEMA.items():
            lowest, largest = (0, _LARGEST_INT) if kind is pl.Int64 else (_LOWEST.get(column, 0.0), _LARGEST_SUM)
            if kind is not pl.String and not frame[column].drop_nulls().is_between(lowest, largest).all():
                raise DataError("rows.csv", f"a value of '{column}' is negative, not finite, or too large")
        self.frame = frame
        return f"{frame.height} rows of {frame['sample'].n_unique()} samples"

    def extract(self, folder: Path) -> None:
        """Write the checked contents as a run folder, with fixed file names and the rows serialized again."""
        make_folder(folder / "rows")
        for name in self.entries.keys() & {"manifest.json", PROFILE}:
            write_bytes(folder / name, self.entries[name])
        write_shard(folder / "rows", PACK, self.frame)
