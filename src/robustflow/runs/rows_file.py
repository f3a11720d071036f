"""Write a run's rows as one file for other programs."""

from __future__ import annotations

import io

import polars as pl

from ..errors import unknown_name
from ..metrics.rows import ROW_SCHEMA_VERSION
from ..text import text_cell
from .run import Run

ROWS_FORMATS = ("csv", "parquet")


def rows_bytes(run: Run, format: str) -> bytes:
    """Return the rows of a run, sorted by sample, corruption and severity, as a file."""
    rows = run.rows.sort("sample", "corruption", "severity")
    out = io.BytesIO()
    if format == "csv":
        texts = [name for name, kind in rows.schema.items() if kind == pl.String]
        safe = pl.col(texts).map_elements(text_cell, return_dtype=pl.String)
        rows.with_columns(safe).write_csv(out)
    elif format == "parquet":
        about = {
            "robustflow_run": run.manifest.identity_digest,
            "robustflow_row_schema": str(ROW_SCHEMA_VERSION),
        }
        rows.write_parquet(out, metadata=about)
    else:
        raise unknown_name("format of rows", format, ROWS_FORMATS)
    return out.getvalue()
