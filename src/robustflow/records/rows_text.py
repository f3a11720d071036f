"""Rows as text: CSV in one canonical form, so that equal rows give equal bytes whatever wrote them.

A run stores Parquet; a record does not, because the bytes of Parquet differ between versions of the library that writes
it, and because it is compressed inside: the size of a page is unknown until it has been decompressed. Numbers are
written with as many digits as are needed to read back the same number.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

import polars as pl

from ..errors import DataError
from ..metrics.rows import FIRST_SCHEMA, ROW_KEY, ROW_SCHEMA, complete_rows

MOST_ROWS = 2_000_000


def rows_to_text(rows: pl.DataFrame) -> bytes:
    """Rows of a run as CSV: a header, then one line per row in the order of `ROW_KEY`; null is an empty cell.

    >>> from robustflow.metrics.rows import rows_frame
    >>> rows_to_text(rows_frame([]))[:36]
    b'sample,group,corruption,severity,fra'
    """
    return _text(rows, ROW_SCHEMA)


def rows_from_text(text: bytes) -> pl.DataFrame:
    """Read the rows back, with the columns and types of `ROW_SCHEMA`; rows of an earlier version are completed.

    Raises:
        DataError: anything that `rows_to_text` does not write: other columns, a cell of another type, another order, an
            empty cell whose value follows from the others.
    """
    schema = next((one for one in (ROW_SCHEMA, FIRST_SCHEMA) if text.startswith(_heading(one))), None)
    if schema is None:
        raise DataError("rows.csv has other columns than this version writes; use the version that packed it")
    lines = text.count(b"\n") - 1
    if not 0 < lines <= MOST_ROWS:
        raise DataError(f"rows.csv has {lines} lines; a record holds 1 to {MOST_ROWS} rows")
    try:
        rows = pl.read_csv(io.BytesIO(text), schema=schema)
        same = _text(rows, schema) == text
    # A panic inside polars is not a PolarsError, nor even an Exception.
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, UnicodeError, ValueError) as error:
        raise DataError(f"rows.csv cannot be read ({' '.join(str(error).split())[:120]})") from error
    if not same:
        raise DataError("rows.csv is not written as a record writes it: sorted by sample, corruption and severity")
    completed = complete_rows(rows)
    if schema is ROW_SCHEMA and not completed.equals(rows):
        raise DataError("rows.csv: cells whose values follow from the others are empty: it was changed or damaged")
    return completed


def _heading(schema: Iterable[str]) -> bytes:
    return (",".join(schema) + "\n").encode()


def _text(rows: pl.DataFrame, schema: Iterable[str]) -> bytes:
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\n").writerows(rows.select(list(schema)).sort(ROW_KEY).iter_rows())
    return _heading(schema) + out.getvalue().encode()
