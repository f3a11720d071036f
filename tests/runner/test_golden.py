"""Compare a small run with stored rows, to detect any change in the bytes of a corruption or the digits of a metric.

After a deliberate change, increment STREAM_VERSION or ROW_SCHEMA_VERSION and run `python -m tests.rewrite`.
"""

from __future__ import annotations

import polars as pl

from .golden import GOLDEN, rows


def test_rows_are_those_of_the_golden_run(tmp_path):
    found = rows(tmp_path / "run")
    golden = pl.read_csv(GOLDEN, schema=found.schema)
    differing = [a[0] for a, b in zip(found.iter_rows(), golden.iter_rows(), strict=True) if a != b]
    assert not differing
