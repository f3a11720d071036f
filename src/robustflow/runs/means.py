"""Means over images, and means of those, computed exactly: `math.fsum(...) / count`, whatever the order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

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

MetricColumns = dict[str, tuple[str, str, float]]


def scores_by_condition(
    rows: pl.DataFrame, columns: MetricColumns, averaging: Averaging
) -> tuple[Scores, dict[tuple[str, int], Scores]]:
    """Scores on the clean frames, and at each (corruption, severity)."""
    total, count, _ = columns["epe"]
    before = f"clean_{total}"
    values = {name: rows[name].to_list() for triple in columns.values() for name in triple[:2]}
    values[before] = rows[before].to_list()
    samples, places = rows["sample"].to_list(), _places(rows)
    in_clean = places.pop((CLEAN, 0), [])
    clean = Scores(**_means(values, in_clean, columns, averaging))
    with_clean = {samples[place] for place in in_clean if values[count][place]}
    both = {
        condition: [place for place in mine if values[count][place] and samples[place] in with_clean]
        for condition, mine in places.items()
    }
    paired = {"epe": columns["epe"], "before": (before, count, 1.0)}
    by_condition = {}
    for condition, mine in places.items():
        scores = Scores(**_means(values, mine, columns, averaging))
        means = _means(values, both[condition], paired, averaging)
        moved = cre(means["epe"], means["before"])
        by_condition[condition] = scores.model_copy(update={"cre": moved, "crer": crer(moved, clean.epe)})
    return clean, by_condition


def _places(rows: pl.DataFrame) -> dict[tuple[str, int], list[int]]:
    """Row numbers of each (corruption, severity), in the order of first occurrence; plain lists, because splitting a
    table into hundreds of small ones costs a hundred times as much."""
    places: dict[tuple[str, int], list[int]] = {}
    for place, (corruption, severity) in enumerate(rows.select("corruption", "severity").iter_rows()):
        places.setdefault((corruption, 0 if corruption == CLEAN else severity), []).append(place)
    return places


def _means(
    values: dict[str, list[Any]], places: Sequence[int], columns: MetricColumns, averaging: Averaging
) -> dict[str, float | None]:
    """The mean of each metric over images; images without a pixel to measure are left out."""
    out: dict[str, float | None] = {}
    for metric, (total, count, factor) in columns.items():
        sums, counts = values[total], values[count]
        images = [(sums[place], n) for place in places if (n := counts[place])]
        if averaging == "image":
            out[metric] = _mean([factor * s / n for s, n in images])
        else:
            pixels = sum(n for _, n in images)
            out[metric] = factor * math.fsum(s for s, _ in images) / pixels if pixels else None
    return out


def clean_flow_length(rows: pl.DataFrame, averaging: Averaging) -> float | None:
    """Mean length of the predicted flow on the clean frames, pixels, over all predicted pixels; None without any."""
    clean = rows.filter(corruption=CLEAN).select("pred_magnitude_sum", "n_all").to_dict(as_series=False)
    places = range(len(clean["n_all"]))
    return _means(clean, places, {"length": ("pred_magnitude_sum", "n_all", 1.0)}, averaging)["length"]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def mean_scores(parts: Sequence[Scores], clean: Scores) -> Scores:
    """Mean of each metric over severities or corruptions; CREr is the ratio of the means."""
    means = {metric: _mean([getattr(part, metric) for part in parts]) for metric in METRICS}
    return Scores(**means | {"crer": crer(means["cre"], clean.epe)})
