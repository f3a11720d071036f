"""Rows as canonical CSV text, so that equal rows always have equal bytes.

A run stores Parquet. A record does not, because the bytes of Parquet depend on the version of the library, and because
the size of its compressed pages is unknown until they are decompressed. Numbers are written with the fewest digits that
restore the same value.
"""

from __future__ import annotations

import csv
import io

import polars as pl

from ..errors import DataError
from ..metrics.rows import ROW_KEY, ROW_SCHEMA

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
