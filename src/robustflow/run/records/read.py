"""Read a record file step by step: each step trusts only what the previous ones have checked."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import polars as pl

from ...core.errors import DataError
from ...core.files import make_folder, sealed, write_bytes, write_json
from ...core.text import plain
from ...core.types import TRUTHS
from ...corruptions.api import STREAM_VERSION
from ...metrics.rows import ROW_KEY, ROW_SCHEMA, ROW_SCHEMA_VERSION, SIGNED
from ..costs import PROFILE, parse_cost
from ..identity import IDENTITY_VERSION
from ..manifest import MANIFEST_SCHEMA, Manifest
from ..shards import PACK, write_shard
from .container import LIMITS, check_text, read_container, read_json
from .contents import MOST_ROWS, Record, check_version, parsed, rows_from_text

STEPS = ("container", "record", "hashes", "manifest", "rows")
"""The methods of `Reader`, in the order in which they must be called."""

_ALWAYS = (
    *("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width", "n_invalid", "n_all"),
    *("rcre_all_sum", "pred_magnitude_sum", "n_photometric", "photometric_sum", "photometric_still_sum"),
)
_LARGEST_INT, _LARGEST_SUM = 2**53, 1e18


class Reader:
    """Reader of one record. Every step returns a sentence that describes what it checked, or raises."""

    entries: dict[str, bytes]
    facts: Record
    plan: Manifest
    frame: pl.DataFrame
    summary: dict[str, Any]

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
        check_version(read_json(data, "record.json"))
        self.facts = parsed(Record.model_validate_json, data, "record.json")
        return f"version {self.facts.version}"

    def hashes(self) -> str:
        """Check that every entry has the size and hash listed in `record.json`."""
        others = [name for name in LIMITS if name in self.entries and name != "record.json"]
        if sorted(self.facts.entries) != sorted(others):
            raise DataError(
                f"record.json lists {', '.join(sorted(self.facts.entries))[:200]}, but the file has different entries"
            )
        for name in others:
            entry, data = self.facts.entries[name], self.entries[name]
            if (entry.bytes, entry.sha256) != (len(data), hashlib.sha256(data).hexdigest()):
                raise DataError(f"{name} does not match its SHA-256 in record.json: it was changed or damaged")
        return f"{len(others)} entries"

    def manifest(self) -> str:
        """Check that `manifest.json` matches its schema, and that its digest matches its identity."""
        content = read_json(self.entries["manifest.json"], "manifest.json")
        if (schema := content.get("schema")) != MANIFEST_SCHEMA or isinstance(schema, bool):
            raise DataError(
                f"manifest.json has schema {plain(str(schema), 20)}, but this version reads {MANIFEST_SCHEMA}; use the "
                "version that packed it"
            )
        self.plan = parsed(Manifest.read, content, "manifest.json")
        self._check_extent()
        if self.plan.shareable().record() != content:
            raise DataError(
                "manifest.json has fields that a record must omit (environment.command, places, the version of "
                "the operating system, fields with their default values); pack the run again"
            )
        measuring, digest = self.plan.identity.measuring, self.plan.identity_digest
        versions = (measuring.version, self.plan.identity.frames.streams, measuring.rows)
        if versions != (IDENTITY_VERSION, STREAM_VERSION, ROW_SCHEMA_VERSION):
            raise DataError(
                f"manifest.json has versions {versions} (identity, streams, rows), but this version reads "
                f"{(IDENTITY_VERSION, STREAM_VERSION, ROW_SCHEMA_VERSION)}; use the version that packed it"
            )
        made = self.plan.identity.digest()
        if not made == digest == self.facts.run:
            raise DataError(
                f"the digest is {self.facts.run} in record.json and {digest} in manifest.json, but the identity "
                f"has {made}"
            )
        if PROFILE in self.entries:
            read_json(self.entries[PROFILE], PROFILE)
            if parse_cost(self.entries[PROFILE], PROFILE).run != digest:
                raise DataError(f"{PROFILE} belongs to a different run")
        return f"run {digest}"

    def _check_extent(self) -> None:
        """Check that at least one corruption or attack of one sample is planned, and that a record can contain all
        rows."""
        if not any(part.corruptions or part.attacks for part in self.plan.planned):
            raise DataError("manifest.json: no corruption or attack of a sample is planned")
        planned = sum(part.count() for part in self.plan.planned)
        if planned > MOST_ROWS:
            raise DataError(f"manifest.json: {planned} rows are planned; the limit for a record is {MOST_ROWS}")

    def rows(self) -> str:
        """Check that rows have the right types, are unique, and contain only numbers in range and printable text."""
        frame = rows_from_text(self.entries["rows.csv"])
        nulls = [name for name in _ALWAYS if frame[name].null_count()]
        if nulls:
            raise DataError(f"rows.csv: the column '{nulls[0]}' has empty cells")
        duplicates = frame.select(ROW_KEY).is_duplicated()
        if duplicates.any():
            sample, corruption, severity = frame.filter(duplicates).select(ROW_KEY).row(0)
            raise DataError(
                f"rows.csv: sample '{plain(sample)}', {plain(corruption)} severity {severity} appears twice"
            )
        for column in ("sample", "group", "corruption"):
            for text in frame[column].unique():
                check_text(text, f"rows.csv, {column}")
                if not 0 < len(text) <= 500:
                    raise DataError(f"rows.csv: a {column} has {len(text)} characters; expected 1 to 500")
        for column in ("frames_digest", "truth_digest"):
            if not frame[column].drop_nulls().str.contains("^[0-9a-f]{32}$").all():
                raise DataError(f"rows.csv: a {column} does not consist of 32 hexadecimal digits")
        if unknown := set(frame["truth"].unique()) - set(TRUTHS):
            raise DataError(
                f"rows.csv: a row has the truth '{plain(min(unknown), 20)}'; expected {' or '.join(TRUTHS)}"
            )
        if not frame["truth_digest"].is_null().equals(frame["n_valid"].is_null()):
            raise DataError("rows.csv: a row has a truth_digest but no pixels with ground truth, or vice versa")
        for column, kind in ROW_SCHEMA.items():
            if kind is pl.Int64 and not frame[column].drop_nulls().is_between(0, _LARGEST_INT).all():
                raise DataError(f"rows.csv: a value of '{column}' is negative or too large")
            lowest = -_LARGEST_SUM if column == "attack_way_gone" else -1.0 if column in SIGNED else 0.0
            if kind is pl.Float64 and not frame[column].drop_nulls().is_between(lowest, _LARGEST_SUM).all():
                raise DataError(f"rows.csv: a value of '{column}' is negative, not finite, or too large")
        self.frame = frame
        self.summary = read_json(self.entries["summary.json"], "summary.json")
        return f"{frame.height} rows of {frame['sample'].n_unique()} samples"

    def extract(self, folder: Path) -> None:
        """Write the checked contents as a run folder, with fixed file names and the rows serialized again."""
        make_folder(folder / "rows")
        write_json(folder / "manifest.json", sealed(self.plan.record()))
        for name in ("summary.json", PROFILE):
            if name in self.entries:
                write_bytes(folder / name, self.entries[name])
        write_shard(folder / "rows", PACK, self.frame)
