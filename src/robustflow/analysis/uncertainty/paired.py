"""Two models on the same samples: differences, intervals, p-values, Holm's correction, and a sentence.

The same image is hard for both models, so the difference is taken image by image before anything is averaged; the test
is based on its spread.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
import polars as pl

from ...errors import RunError
from ...metrics.rows import ROW_KEY
from ...text import joined
from .bootstrap import LEVEL, RESAMPLES, Interval, bootstrap
from .holm import holm
from .intervals import MetricKey, statistics_of
from .sentences import difference_sentence
from .sums import AVERAGE, CLEAN, ClusterSums

COMPARISON_SCHEMA: dict[str, Any] = {
    "first": pl.String,
    "second": pl.String,
    "metric": pl.String,
    "corruption": pl.String,
    "value_first": pl.Float64,
    "value_second": pl.Float64,
    "difference": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "p": pl.Float64,
    "p_holm": pl.Float64,
    "comparisons": pl.Int64,
    "images": pl.Int64,
    "clusters": pl.Int64,
    "level": pl.Float64,
    "sentence": pl.String,
}
"""`difference` is first minus second: below 0 the first is lower. `p_holm` is corrected over `comparisons`."""


def compare_rows(
    first: pl.DataFrame,
    second: pl.DataFrame,
    names: tuple[str, str] = ("first", "second"),
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Whether two models differ: in clean EPE, and in EPE, CRE, CREr and RCRE, on average and per corruption.

    Only what both runs measured is compared. p-values are corrected over all lines of one metric.

    Args:
        first, second: rows of two runs over the same samples.
        names: of the models, for the sentences.
        level, resamples, seed: of the bootstrap.

    Returns:
        Columns of `COMPARISON_SCHEMA`.

    Raises:
        RunError: nothing in common, or different frames under the same names (another seed, variant or data).
    """
    sums = tuple(ClusterSums.of(rows) for rows in common_rows(first, second, names))
    gap = _clean_gap(sums)
    differences = _differences(sums, statistics_of(sums[0]), level, resamples, seed)
    by_metric: dict[str, list[MetricKey]] = {}
    for key in differences:
        by_metric.setdefault(key[0], []).append(key)
    records = []
    for keys in by_metric.values():
        adjusted = _adjusted([differences[key][0] for key in keys])
        for key, p_holm in zip(keys, adjusted, strict=True):
            records.append(_record(names, key, differences[key], p_holm, len(keys), sums[0], level, gap))
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA, orient="row")


def compare_all(
    runs: Mapping[str, pl.DataFrame],
    metric: str = "cre",
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """All pairs of many models compared in the average of one metric, corrected over all pairs: `COMPARISON_SCHEMA`.

    Only what all of them measured is compared, so a model has the same value in all its lines.

    Raises:
        RunError: nothing in common, or different frames under the same names.
    """
    key: MetricKey = (metric, AVERAGE, None)
    runs = common_to_all(runs)
    pairs = []
    for names in combinations(runs, 2):
        sums = tuple(ClusterSums.of(rows) for rows in common_rows(runs[names[0]], runs[names[1]], names))
        if all(one.measured(*key) for one in sums):
            pairs.append((names, sums, _differences(sums, [key], level, resamples, seed)[key]))
    adjusted = _adjusted([difference[0] for _, _, difference in pairs])
    records = [
        _record(names, key, difference, p_holm, len(pairs), sums[0], level, _clean_gap(sums))
        for (names, sums, difference), p_holm in zip(pairs, adjusted, strict=True)
    ]
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA, orient="row")


def common_to_all(runs: Mapping[str, pl.DataFrame]) -> dict[str, pl.DataFrame]:
    """The rows of many runs for the (sample, corruption, severity) that all of them measured.

    Raises:
        RunError: there are none, or the frames under them are not the same.
    """
    names = list(runs)
    common = runs[names[0]]
    for name in names[1:]:
        common = common_rows(common, runs[name], (names[0], name))[0]
    keys = common.select(ROW_KEY)
    return {name: rows.join(keys, on=list(ROW_KEY), how="semi") for name, rows in runs.items()}


def common_remark(runs: Mapping[str, pl.DataFrame]) -> str:
    """What a comparison of these runs leaves out because not all of them measured it; "" if nothing."""
    common = next(iter(common_to_all(runs).values())).height
    if all(rows.height == common for rows in runs.values()):
        return ""
    counts = [f"the {rows.height} of {name}" for name, rows in runs.items()]
    measured = "both" if len(runs) == 2 else "all"
    return f"Only what {measured} measured is compared: {common} rows (a pair, clean or corrupted) of {joined(counts)}."


def common_rows(first: pl.DataFrame, second: pl.DataFrame, names: tuple[str, str]) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The rows of both runs about the same (sample, corruption, severity).

    Raises:
        RunError: there are none, or the frames under them are not the same.
    """
    keys = list(ROW_KEY)
    both = first.select(*keys, "frames_digest").join(
        second.select(*keys, "frames_digest"), on=keys, how="inner", suffix="_second"
    )
    if both.is_empty():
        raise RunError(
            f"{names[0]} and {names[1]} have no sample, corruption and severity in common; "
            "compare runs over the same data"
        )
    other = both.filter(pl.col("frames_digest") != pl.col("frames_digest_second"))
    if other.height:
        sample, corruption, severity = other.sort(keys).select(keys).row(0)
        raise RunError(
            f"{names[0]} and {names[1]} were given different frames under the same name (sample '{sample}', "
            f"{corruption} severity {severity}; {other.height} differ); compare runs of the same data, seed, variant "
            "and frost textures; or, where only one of the manifests gives version 1 of the rows (identity, rows), "
            "whose digests are another hash, run that one again"
        )
    common = both.select(keys)
    return first.join(common, on=keys, how="semi"), second.join(common, on=keys, how="semi")


_Difference = tuple[Interval, float, float]


def _differences(
    sums: tuple[ClusterSums, ...], keys: list[MetricKey], level: float, resamples: int, seed: int
) -> dict[MetricKey, _Difference]:
    first, second = sums
    if first.clusters != second.clusters:
        raise RunError("the two runs group their samples differently; compare runs of the same data")
    keys = [key for key in keys if second.measured(*key)]

    statistics = {key: first.statistic(*key) - second.statistic(*key) for key in keys}
    intervals = bootstrap(statistics, len(first.clusters), level=level, resamples=resamples, seed=seed, symmetric=True)
    whole = np.ones((1, len(first.clusters)))
    return {
        key: (
            intervals[key],
            float(first.statistic(*key)(whole).theta[0]),
            float(second.statistic(*key)(whole).theta[0]),
        )
        for key in keys
        if np.isfinite(intervals[key].estimate)
    }


def _clean_gap(sums: tuple[ClusterSums, ...]) -> float | None:
    """Clean EPE of the first minus that of the second, pixels; None without ground truth."""
    key: MetricKey = ("epe", CLEAN, None)
    if not all(one.measured(*key) for one in sums):
        return None
    whole = np.ones((1, len(sums[0].clusters)))
    first, second = (float(one.statistic(*key)(whole).theta[0]) for one in sums)
    return first - second


def _adjusted(intervals: list[Interval]) -> list[float | None]:
    known = [one.p for one in intervals if one.p is not None]
    corrected = iter(holm(known))
    return [None if one.p is None else next(corrected) for one in intervals]


def _record(
    names: tuple[str, str],
    key: MetricKey,
    difference: _Difference,
    p_holm: float | None,
    comparisons: int,
    sums: ClusterSums,
    level: float,
    clean_gap: float | None,
) -> tuple[Any, ...]:
    interval, value_first, value_second = difference
    numbers = (interval.estimate, interval.low, interval.high, interval.p, p_holm, comparisons)
    counts = (sums.images, len(sums.clusters), level)
    sentence = difference_sentence(names, key[0], key[1], interval, p_holm, comparisons, *counts, clean_gap)
    return (*names, key[0], key[1], value_first, value_second, *numbers, *counts, sentence)
