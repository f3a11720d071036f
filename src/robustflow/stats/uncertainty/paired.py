"""Compare models on the same samples: differences per image, intervals, p-values with Holm's correction, and ranks.

An image that is hard for one model is usually hard for the other, so differences are computed per image before
averaging, and the test is based on the spread of these differences.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, combinations, combinations_with_replacement, groupby
from string import ascii_letters
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from ...core.errors import RunError
from ...core.text import counted
from ...run.comparable import common_rows
from ..ranking import competition_ranks
from ..results import METRIC_LABELS, UNITS, long_label
from .bootstrap import LEVEL, RESAMPLES, bootstrap
from .intervals import MetricKey, statistics_of
from .statistic import Array, difference
from .sums import AVERAGE, CLEAN, ClusterSums


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values by Holm's step-down method (Holm 1979). Rejecting every hypothesis whose adjusted p-value is
    below a level keeps the probability of any false rejection below this level, regardless of the dependence
    between the tests.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def difference_sentence(row: Mapping[str, Any]) -> str:
    """State the difference between two models in one mean, and its uncertainty (a row of `COMPARISON_SCHEMA`).

    >>> row = {"first": "A", "second": "B", "metric": "cre", "corruption": "average", "difference": -0.42, "low": -0.7,
    ...        "high": -0.1, "p_holm": 0.02, "comparisons": 1, "images": 80, "clusters": 80, "level": 0.95}
    >>> difference_sentence(row)
    'average CRE of A minus B: -0.42 px (95 % interval -0.70 to -0.10; p = 0.020; 80 images): A is lower.'
    """
    first, second, metric, unit = row["first"], row["second"], row["metric"], UNITS[row["metric"]]
    what = {AVERAGE: "average", CLEAN: "clean"}.get(row["corruption"], long_label(row["corruption"]))
    images = counted(row["images"], "image")
    observed = images if row["clusters"] == row["images"] else f"{images} in {counted(row['clusters'], 'sequence')}"
    bounded = row["low"] is not None and row["high"] is not None
    interval = f"interval {row['low']:+.2f} to {row['high']:+.2f}" if bounded else "interval unbounded"
    evidence = [f"{100 * row['level']:g} % {interval}", observed]
    if row["p_holm"] is not None:
        corrected = f", corrected for {row['comparisons']} comparisons" if row["comparisons"] > 1 else ""
        evidence.insert(1, f"p {p_text(row['p_holm'])}{corrected}")
    verdict = "they cannot be told apart"
    if row["p_holm"] is None:
        verdict = "too few to tell them apart"
    elif bounded and row["p_holm"] < 1 - row["level"]:
        verdict = f"{first if row['difference'] < 0 else second} is lower"
    difference = f"{row['difference']:+.2f} {unit}".rstrip()
    return f"{what} {METRIC_LABELS[metric]} of {first} minus {second}: {difference} ({'; '.join(evidence)}): {verdict}."


def p_text(value: float) -> str:
    """Format a p-value as written after the letter p; values below 0.001 are written as "< 0.001".

    >>> p_text(0.0204), p_text(0.0004)
    ('= 0.020', '< 0.001')
    """
    return "< 0.001" if value < 0.001 else f"= {value:.3f}"


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
    "equal": pl.Int64,
    "blow_ups_first": pl.Int64,
    "blow_ups_second": pl.Int64,
    "level": pl.Float64,
    "sentence": pl.String,
}
"""`difference` is first minus second, and thus negative if the first is lower. `p_holm` is corrected for `comparisons`
tests. `equal` is the number of images on which both have the same value (for CREr, the same CRE), and `blow_ups_first`
the number of images on which the error of the first (EPE, or RCRE without ground truth) is more than `BLOW_UP` times
that of the second. `low` and `high` are null if there are too few clusters or the interval has no finite ends."""

BLOW_UP = 10.0


def compare_rows(
    first: pl.DataFrame,
    second: pl.DataFrame,
    names: tuple[str, str] = ("first", "second"),
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Test whether two models differ in clean EPE and in EPE, CRE, CREr and RCRE, on average and per corruption."""
    one, other = (_Sums.of(rows) for rows in common_rows((first, second), names)[0])
    found = _differences(names, (one, other), statistics_of(one.clusters), level, resamples, seed)
    if not found:
        raise RunError(" and ".join(names), "no measured mean in common; robustflow report lists those of each")
    return _table([list(of_metric) for _, of_metric in groupby(found, lambda row: row["metric"])])


def compare_all(
    runs: Mapping[str, pl.DataFrame],
    metric: str = "cre",
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Compare all pairs of models on the average of one metric, corrected over all pairs (`COMPARISON_SCHEMA`)."""
    common, _ = common_rows(list(runs.values()), list(runs))
    of_run = {name: _Sums.of(rows) for name, rows in zip(runs, common, strict=True)}
    found: list[_Row] = []
    for pair in combinations(of_run, 2):
        sums = of_run[pair[0]], of_run[pair[1]]
        found += _differences(pair, sums, [(metric, AVERAGE, None)], level, resamples, seed)
    return _table([found])


class _Sums(NamedTuple):
    """The errors of one run, added up per cluster and per image."""

    clusters: ClusterSums
    images: ClusterSums

    @classmethod
    def of(cls, rows: pl.DataFrame) -> _Sums:
        return cls(ClusterSums.of(rows), ClusterSums.of(rows.with_columns(group="sample")))

    def of_images(self, key: MetricKey) -> Array:
        """Return the error of each image, or its increase; NaN where it was not measured."""
        mean = self.images.error_mean(*key).mean
        with np.errstate(invalid="ignore"):
            return mean.total / mean.count


_Row = dict[str, Any]
"""A row of `COMPARISON_SCHEMA`."""


def _differences(
    names: tuple[str, str],
    sums: tuple[_Sums, _Sums],
    keys: Sequence[MetricKey],
    level: float,
    resamples: int,
    seed: int,
) -> list[_Row]:
    """Return the differences between two models in the means that both have, before the correction of p."""
    first, second = (one.clusters for one in sums)
    if first.clusters != second.clusters:
        raise RunError("group", "the two runs group their samples differently; compare runs on the same data")
    clusters = len(first.clusters)
    differences = {
        key: difference(first.error_mean(*key), second.error_mean(*key))
        for key in keys
        if first.measured(*key) and second.measured(*key)
    }
    rows = []
    for key, found in bootstrap(differences, clusters, level=level, resamples=resamples, seed=seed).items():
        if not np.isfinite(found.estimate):
            continue
        row: _Row = {"metric": key[0], "corruption": key[1], "difference": found.estimate, "p": found.p}
        row |= {"low": found.low, "high": found.high, "level": level}
        row["clusters"] = int(np.count_nonzero(first.error_mean(*key).mean.count))
        one, other = (each.of_images(key) for each in sums)
        row |= {"images": int(np.isfinite(one).sum()), "equal": int(np.count_nonzero(one == other))}
        values = first.mean(*key), second.mean(*key)
        of_models = zip(("first", "second"), names, values, _blow_ups(sums, key), strict=True)
        for place, name, value, count in of_models:
            row |= {place: name, f"value_{place}": value, f"blow_ups_{place}": count}
        rows.append(row)
    return rows


def _blow_ups(sums: tuple[_Sums, _Sums], key: MetricKey) -> tuple[int, int]:
    """Count the images on which the error of one model is more than `BLOW_UP` times that of the other."""
    _, corruption, severity = key
    metric = "epe" if sums[0].clusters.measured("epe", corruption, severity) else "rcre"
    one, other = (each.of_images((metric, corruption, severity)) for each in sums)
    return int(np.count_nonzero(one > BLOW_UP * other)), int(np.count_nonzero(other > BLOW_UP * one))


def _table(groups: Iterable[Sequence[_Row]]) -> pl.DataFrame:
    """Tabulate differences, with p-values corrected within each group."""
    records = []
    for rows in groups:
        tested = [row["p"] for row in rows if row["p"] is not None]
        adjusted = iter(holm(tested))
        for row in rows:
            corrected = row | {"p_holm": None if row["p"] is None else next(adjusted), "comparisons": len(tested)}
            records.append(corrected | {"sentence": difference_sentence(corrected)})
    return pl.DataFrame(records, schema=COMPARISON_SCHEMA)


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
        if _is_sure(row):
            better, worse = (row["first"], row["second"])[:: 1 if row["difference"] < 0 else -1]
            beats[better] += 1
            beaten[worse] += 1
    ranks = competition_ranks({name: values[name] for name in names})
    records = [(name, values[name], ranks[name], beaten[name] + 1, len(names) - beats[name]) for name in names]
    return pl.DataFrame(records, schema=STANDINGS_SCHEMA, orient="row").sort("rank", "model")


def group_letters(pairs: pl.DataFrame, names: Sequence[str]) -> dict[str, str]:
    """Return the letters of each model, of which two models share one unless a test tells them apart (the compact
    letter display of Piepho 2004). "a" is the group of the first name.

    >>> rows = [{"first": "A", "second": "C", "p_holm": 0.01, "level": 0.95}]
    >>> group_letters(pl.DataFrame(rows), ["A", "B", "C"])
    {'A': 'a', 'B': 'ab', 'C': 'b'}
    """
    groups, alike = [frozenset(names)], set(map(frozenset, combinations_with_replacement(names, 2)))
    for row in filter(_is_sure, pairs.iter_rows(named=True)):
        two = frozenset((row["first"], row["second"]))
        alike.discard(two)
        groups = [part for group in groups for part in ([group - {one} for one in two] if two <= group else [group])]
        groups = [group for group in dict.fromkeys(groups) if not any(group < other for other in groups)]
    lettered = []
    while alike:  # a few of the groups suffice; 20 models can have more than a thousand
        lettered.append(max(groups, key=lambda group: sum(two <= group for two in alike)))
        alike = {two for two in alike if not two <= lettered[-1]}
    lettered.sort(key=lambda group: [name not in group for name in names])
    letters = list(zip(chain(ascii_letters, map(chr, range(0x3B1, 0x400))), lettered, strict=False))
    return {name: "".join(letter for letter, group in letters if name in group) for name in names}


def _is_sure(row: Mapping[str, Any]) -> bool:
    return row["p_holm"] is not None and row["p_holm"] < 1 - row["level"]
