"""The contents of a record: `record.json`, the run's manifest without details that identify a machine, and the rows as
canonical CSV text, so that equal rows always have equal bytes.

A run stores Parquet. A record does not, because the bytes of Parquet depend on the version of the library, and because
the size of its compressed pages is unknown until they are decompressed. Numbers are written with the fewest digits that
restore the same value.
"""

from __future__ import annotations

import csv
import io
import json
from typing import Annotated, Literal

import polars as pl
from pydantic import Field, field_validator

from ...core.errors import DataError, RunError
from ...core.text import plain
from ...core.types import Untrusted
from ...metrics.rows import ROW_KEY, ROW_SCHEMA
from ..manifest import Manifest
from .container import holds_path, texts

VERSION = 3
"""Version of a record's contents, incremented when the contents or their meaning change."""

MOST_ROWS = 2_000_000
_HEADING = (",".join(ROW_SCHEMA) + "\n").encode()


class Record(Untrusted):
    """`record.json`: the version of the file, the digest of the run's identity, the SHA-256 of the other entries, and
    what the submitter wrote: author, link and description are arbitrary plain text."""

    format: Literal["robustflow-record"] = "robustflow-record"
    version: Literal[3] = 3
    run: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    complete: bool
    entries: dict[str, Annotated[str, Field(pattern="^[0-9a-f]{64}$")]]
    author: Annotated[str, Field(max_length=200)] = ""
    link: Annotated[str, Field(max_length=500)] = ""
    description: Annotated[str, Field(max_length=2000)] = ""

    @field_validator("link")
    @classmethod
    def _web_address(cls, link: str) -> str:
        if link and not link.startswith("https://"):
            raise ValueError("a link must begin with https://")
        return link


def shareable_manifest(manifest: Manifest, keep_paths: bool = False) -> Manifest:
    """Return a run's manifest as stored in a record: file names without folders, kind of machine, versions, times.

    Raises:
        RunError: a text contains a path on this machine, but is part of the run's identity and cannot be left out;
            `keep_paths` allows such texts.
    """
    out = manifest.judged().shareable()
    for where, text in () if keep_paths else texts(json.loads(out.document())):
        if holds_path(text):
            raise RunError(
                where or "manifest.json",
                f"'{plain(text, 60)}' is a path on this machine that would be published; run again with a "
                "relative path, or give --keep-paths",
            )
    return out


def rows_to_text(rows: pl.DataFrame) -> bytes:
    """Return a run's rows as CSV: a header, then one line per row in the order of `ROW_KEY`; null is an empty cell."""
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\n").writerows(rows.select(list(ROW_SCHEMA)).sort(ROW_KEY).iter_rows())
    return _HEADING + out.getvalue().encode()


def rows_from_text(text: bytes) -> pl.DataFrame:
    """Parse CSV text into rows with the columns and types of `ROW_SCHEMA`."""
    if not text.startswith(_HEADING):
        raise DataError("rows.csv", "does not have the columns of this version; use the version that packed it")
    lines = text.count(b"\n") - 1
    if not 0 < lines <= MOST_ROWS:
        raise DataError("rows.csv", f"has {lines} lines; a record has 1 to {MOST_ROWS} rows")
    try:
        rows = pl.read_csv(io.BytesIO(text), schema=ROW_SCHEMA)
        same = rows_to_text(rows) == text
    # A panic inside polars is not a PolarsError, nor even an Exception.
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, UnicodeError, ValueError) as error:
        raise DataError("rows.csv", f"cannot be read ({' '.join(str(error).split())[:120]})") from error
    if not same:
        raise DataError("rows.csv", "not in canonical form: sorted by sample, corruption and severity")
    return rows
