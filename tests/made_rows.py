"""Rows that a test writes by hand: what follows from the others is filled in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import polars as pl

from robustflow.metrics.regions import REGIONS
from robustflow.metrics.rows import CLEAN, ROW_SCHEMA
from robustflow.metrics.rows import rows_frame as frame_of

_CLEAN_SUMS = {
    "epe_sum": "n_valid",
    **{f"epe_sum_{region}": f"n_{region}" for region in REGIONS},
}


def rows_frame(rows: Iterable[dict[str, Any]]) -> pl.DataFrame:
    """The columns of `ROW_SCHEMA`: the clean error's sums are those of the sample's clean row, every pixel with ground
    truth is predicted, and the digests are of the sample and the condition, where a row does not give them."""
    rows = [dict.fromkeys(ROW_SCHEMA) | row for row in rows]
    clean = {row["sample"]: row for row in rows if row["corruption"] == CLEAN}
    return frame_of(_filled(row, clean.get(row["sample"], {})) for row in rows)


def _filled(row: dict[str, Any], clean: dict[str, Any]) -> dict[str, Any]:
    follows = {f"clean_{total}": clean.get(total) for total, count in _CLEAN_SUMS.items() if row[count] is not None}
    follows["frames_digest"] = f"{row['sample']} {row['corruption']} {row['severity']}"
    if row["n_valid"] is not None:
        follows |= {"n_truth": row["n_valid"], "truth_digest": f"truth of {row['sample']}"}
    return row | {name: value for name, value in follows.items() if row[name] is None}
