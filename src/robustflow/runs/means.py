"""Means over images, and means of those, in one exact way: `math.fsum(...) / count`, whatever the order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import polars as pl

from ..metrics.robustness import cre, crer
from ..metrics.rows import CLEAN
from ..metrics.summary import METRICS, Averaging, Scores

WHOLE = {
    "epe": ("epe_sum", "n_valid", 1.0),
    "rcre_all": ("rcre_all_sum", "n_all", 1.0),
    "fl": ("fl_count", "n_valid", 100.0),
    "px1": ("px1_count", "n_valid", 100.0),
    "px3": ("px3_count", "n_valid", 100.0),
    "px5": ("px5_count", "n_valid", 100.0),
    "wauc": ("wauc_sum", "n_valid", 100.0),
    "coverage": ("n_covered", "n_wanted", 1.0),
}
"""Metric: (column of its sum, column of its count, factor)."""

Columns = dict[str, tuple[str, str, float]]


def scores_by_condition(
    rows: pl.DataFrame, columns: Columns, averaging: Averaging
) -> tuple[Scores, dict[tuple[str, int], Scores]]:
    """Scores on the clean frames, and at each (corruption, severity).

    CRE is None throughout where rows of an earlier version do not say what the clean error is over their pixels.
    """
    total, count, _ = columns["epe"]
    before = f"clean_{total}"
    clean_rows = rows.filter(pl.col("corruption") == CLEAN)
    clean = Scores(**_means(clean_rows, columns, averaging))
    partner = clean_rows.select("sample", _clean_n=count)
    conditions = rows.filter(pl.col("corruption") != CLEAN).join(
        partner, on="sample", how="left", maintain_order="left"
    )
    comparable = conditions.filter((pl.col(count) > 0) & (pl.col("_clean_n") > 0))[before].null_count() == 0
    by_condition = {}
    for key, group in conditions.partition_by("corruption", "severity", as_dict=True, maintain_order=True).items():
        corruption, severity = key
        both = group.filter((pl.col(count) > 0) & (pl.col("_clean_n") > 0))
        scores = Scores(**_means(group, columns, averaging))
        moved = None
        if comparable:
            paired = _means(both, {"epe": columns["epe"], "before": (before, count, 1.0)}, averaging)
            moved = cre(paired["epe"], paired["before"])
        by_condition[corruption, severity] = scores.model_copy(update={"cre": moved, "crer": crer(moved, clean.epe)})
    return clean, by_condition


def _means(rows: pl.DataFrame, columns: Columns, averaging: Averaging) -> dict[str, float | None]:
    """The mean of each metric over images; images without a pixel to measure are left out."""
    out: dict[str, float | None] = {}
    for metric, (total, count, factor) in columns.items():
        images = [(s, n) for s, n in zip(rows[total].to_list(), rows[count].to_list(), strict=True) if n]
        if averaging == "image":
            out[metric] = _mean([factor * s / n for s, n in images])
        else:
            pixels = sum(n for _, n in images)
            out[metric] = factor * math.fsum(s for s, _ in images) / pixels if pixels else None
    return out


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def mean_scores(parts: Sequence[Scores], clean: Scores) -> Scores:
    """Mean of each metric over severities or corruptions; CREr is the ratio of the means."""
    means = {metric: _mean([getattr(part, metric) for part in parts]) for metric in METRICS}
    return Scores(**means | {"crer": crer(means["cre"], clean.epe)})
