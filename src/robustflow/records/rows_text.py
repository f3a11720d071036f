"""Rows as text: CSV in one canonical form, so that equal rows are equal bytes whatever wrote them.

Parquet is what a run keeps; a record does not, because its bytes differ between versions of the library that writes it,
and because it is compressed inside: nobody can tell how much a page unfolds to before it has. Numbers are written with
as many digits as it takes to read the same number back.
"""

from __future__ import annotations

import csv
import io

import polars as pl

from ..errors import DataError
from ..metrics.rows import ROW_KEY, ROW_SCHEMA

MOST_ROWS = 2_000_000
_HEADING = ",".join(ROW_SCHEMA) + "\n"


def rows_to_text(rows: pl.DataFrame) -> bytes:
    """Rows of a run as CSV: a heading, then a line per row in the order of `ROW_KEY`; null is an empty cell.

    >>> from robustflow.metrics.rows import rows_frame
    >>> rows_to_text(rows_frame([]))[:36]
    b'sample,group,corruption,severity,fra'
    """
    out = io.StringIO(newline="")
    out.write(_HEADING)
    csv.writer(out, lineterminator="\n").writerows(rows.select(list(ROW_SCHEMA)).sort(ROW_KEY).iter_rows())
    return out.getvalue().encode()


def rows_from_text(text: bytes) -> pl.DataFrame:
    """The rows back, columns and types of `ROW_SCHEMA`.

    Raises:
        DataError: anything that `rows_to_text` does not write: other columns, a cell of another type, another order.
    """
    if not text.startswith(_HEADING.encode()):
        raise DataError("rows.csv has other columns than this version writes; use the version that packed it")
    lines = text.count(b"\n") - 1
    if not 0 < lines <= MOST_ROWS:
        raise DataError(f"rows.csv has {lines} lines; a record holds 1 to {MOST_ROWS} rows")
    try:
        rows = pl.read_csv(io.BytesIO(text), schema=ROW_SCHEMA)
        same = rows_to_text(rows) == text
    # A panic inside polars is no PolarsError, and not even an Exception.
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, UnicodeError, ValueError) as error:
        raise DataError(f"rows.csv cannot be read ({' '.join(str(error).split())[:120]})") from error
    if not same:
        raise DataError("rows.csv is not written as a record writes it: sorted by sample, corruption and severity")
    return rows
