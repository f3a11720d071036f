"""Determine the possible ranks of several models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import polars as pl

from ...errors import RunError
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
    """Rank several models with ties: each model's rank, and the range of ranks that the paired tests allow.

    A model that is significantly worse than m others (Holm's correction over all pairs) has rank m + 1 at best; a model
    that is significantly better than m others has at least m models ranked below it.

    Args:
        pairs: comparisons of all pairs of the models, from `compare_all`.
        names: names of the models.

    Returns:
        A table with the columns of `STANDINGS_SCHEMA`, best model first.

    Raises:
        RunError: if two of the models were not compared.

    >>> pairs = pl.DataFrame({"first": ["a", "a", "b"], "second": ["b", "c", "c"], "value_first": [1.0, 1.0, 1.1],
    ...     "value_second": [1.1, 3.0, 3.0], "difference": [-0.1, -2.0, -1.9], "p_holm": [0.4, 0.01, 0.01],
    ...     "level": [0.95, 0.95, 0.95]})
    >>> standings(pairs, ["a", "b", "c"]).select("model", "best", "worst").rows()
    [('a', 1, 2), ('b', 1, 2), ('c', 3, 3)]
    """
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
