"""Determine the possible ranks of several models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import polars as pl

from ...core.errors import RunError
from ..ranking import competition_ranks

STANDINGS_SCHEMA: dict[str, Any] = {
    "model": pl.String,
    "value": pl.Float64,
    "rank": pl.Int64,
    "best": pl.Int64,
    "worst": pl.Int64,
}
"""`rank` is determined by the values alone; `best` and `worst` are the best and the worst rank that the tests allow."""


def standings(pairs: pl.DataFrame, names: Sequence[str]) -> pl.DataFrame:
    """Rank several models with ties: each model's rank, and the range of ranks that the paired tests allow."""
    if pairs.height != len(names) * (len(names) - 1) // 2:
        raise RunError("not all of these runs measured the same data; a ranking needs runs on the same data")
    values: dict[str, float] = {}
    beaten, beats = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for row in pairs.iter_rows(named=True):
        values[row["first"]], values[row["second"]] = row["value_first"], row["value_second"]
        if row["p_holm"] is not None and row["p_holm"] < 1 - row["level"]:
            better, worse = (row["first"], row["second"])[:: 1 if row["difference"] < 0 else -1]
            beats[better] += 1
            beaten[worse] += 1
    ranks = competition_ranks({name: values[name] for name in names})
    records = [(name, values[name], ranks[name], beaten[name] + 1, len(names) - beats[name]) for name in names]
    return pl.DataFrame(records, schema=STANDINGS_SCHEMA, orient="row").sort("rank", "model")
