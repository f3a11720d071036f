"""The contents of a record: `record.json`, and the run's manifest without details that identify a machine. Rows as
canonical CSV text, so that equal rows always have equal bytes.

A run stores Parquet. A record does not, because the bytes of Parquet depend on the version of the library, and because
the size of its compressed pages is unknown until they are decompressed. Numbers are written with the fewest digits that
restore the same value.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

import polars as pl
from pydantic import Field, ValidationError, field_validator

from ...core.errors import DataError, RunError, first_misfit
from ...core.text import plain
from ...core.types import Untrusted
from ...metrics.rows import ROW_KEY, ROW_SCHEMA
from ..manifest import Manifest
from .container import holds_path, texts

FORMAT = "robustflow-record"
VERSION = 2
"""Version of a record's contents, incremented when the contents or their meaning change."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


class PackedEntry(Untrusted):
    """Size and hash of an entry of the file."""

    bytes: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Record(Untrusted):
    """`record.json`: the format of the file, and its submitter; author, link and description are arbitrary plain
    text."""

    format: Literal["robustflow-record"] = "robustflow-record"
    version: Annotated[int, Field(ge=VERSION, le=VERSION)] = VERSION
    run: _Digest
    complete: bool
    entries: dict[str, PackedEntry]
    author: Annotated[str, Field(max_length=200)] = ""
    link: Annotated[str, Field(max_length=500)] = ""
    description: Annotated[str, Field(max_length=2000)] = ""

    @field_validator("link")
    @classmethod
    def _web_address(cls, link: str) -> str:
        if link and not link.startswith("https://"):
            raise ValueError("a link must begin with https://")
        return link


_Given = TypeVar("_Given")
_Model = TypeVar("_Model")


def parsed(parse: Callable[[_Given], _Model], given: _Given, name: str) -> _Model:
    """Parse a file's content into one of these models.

    Raises:
        DataError: the content does not match the model; the message names the first mismatch.
    """
    try:
        return parse(given)
    except ValidationError as error:
        raise DataError(name, f"{plain(first_misfit(error), 200)} ({error.error_count()} in total)") from error


def check_version(record: dict[str, Any]) -> None:
    """Check that this version can read a `record.json`, before any other field is used.

    Raises:
        DataError: the format is unknown, or its version is different.
    """
    version = record.get("version")
    if record.get("format") != FORMAT or isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise DataError("record.json is not a record of a run; give a file written by 'robustflow record pack'")
    if version != VERSION:
        remedy = "upgrade robustflow to read it" if version > VERSION else "use the version that packed it"
        raise DataError(
            f"record.json has record version {version}, but this RobustFlow reads version {VERSION}: {remedy}"
        )


def shareable_manifest(manifest: Manifest, keep_paths: bool = False) -> Manifest:
    """Return a run's manifest as stored in a record: file names without folders, kind of machine, versions, times.

    Raises:
        RunError: a text contains a path on this machine, but is part of the run's identity and cannot be left out;
            `keep_paths` allows such texts.
    """
    out = manifest.judged().shareable()
    for where, text in () if keep_paths else texts(out.record()):
        if holds_path(text):
            raise RunError(
                f"manifest.json: {where or 'a name'} contains '{plain(text, 60)}', a path on this machine that would "
                "be published; run again with a relative path, or give --keep-paths"
            )
    return out


MOST_ROWS = 2_000_000
_HEADING = (",".join(ROW_SCHEMA) + "\n").encode()


def rows_to_text(rows: pl.DataFrame) -> bytes:
    """Return a run's rows as CSV: a header, then one line per row in the order of `ROW_KEY`; null is an empty cell."""
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\n").writerows(rows.select(list(ROW_SCHEMA)).sort(ROW_KEY).iter_rows())
    return _HEADING + out.getvalue().encode()


def rows_from_text(text: bytes) -> pl.DataFrame:
    """Parse CSV text into rows with the columns and types of `ROW_SCHEMA`."""
    if not text.startswith(_HEADING):
        raise DataError("rows.csv does not have the columns of this version; use the version that packed it")
    lines = text.count(b"\n") - 1
    if not 0 < lines <= MOST_ROWS:
        raise DataError(f"rows.csv has {lines} lines; a record has 1 to {MOST_ROWS} rows")
    try:
        rows = pl.read_csv(io.BytesIO(text), schema=ROW_SCHEMA)
        same = rows_to_text(rows) == text
    # A panic inside polars is not a PolarsError, nor even an Exception.
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, UnicodeError, ValueError) as error:
        raise DataError(f"rows.csv cannot be read ({' '.join(str(error).split())[:120]})") from error
    if not same:
        raise DataError("rows.csv is not in canonical form: sorted by sample, corruption and severity")
    return rows
