"""Sum a run's rows per cluster and condition, the basis of every mean and its resamples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from ...core.errors import UsageError, unknown_name
from ...corruptions.registry import MEMBERS, ordered
from ...metrics.means import AVERAGE, averaged_corruptions
from ...metrics.measures import BEFORE, MEASURES
from ...metrics.rows import CLEAN
from .log_scale import ErrorMean
from .statistic import Array, Mean, Statistic

INTERVAL_METRICS = ("epe", "cre", "crer", "rcre")
Column = tuple[str, int]
"""(corruption, severity)."""


@dataclass(frozen=True, eq=False)
class ClusterSums:
    """Per-image errors of one run, added up per cluster."""

    clusters: tuple[str, ...]
    images: int
    conditions: tuple[Column, ...]
    averaged: frozenset[str]
    sums: dict[str, Array]
    counts: dict[str, Array]
    clean_sum: Array
    clean_count: Array

    @classmethod
    def of(cls, rows: pl.DataFrame) -> ClusterSums:
        """Sum the rows of one run (`robustflow.metrics.rows.ROW_SCHEMA`). Images without valid pixels are left out,
        as in the run's summary."""
        images = image_errors(rows)
        clusters = tuple(images["group"].unique().sort())
        clean, dirty = images.filter(corruption=CLEAN), images.filter(pl.col("corruption") != CLEAN)
        conditions = tuple(dirty.select("corruption", "severity").unique().sort("corruption", "severity").iter_rows())
        added = {name: _sums(dirty, name, clusters, conditions) for name in ("epe", "cre", "rcre", "before")}
        clean_sum, clean_count = _sums(clean, "epe", clusters, ((CLEAN, 0),))
        return cls(
            clusters,
            images["sample"].n_unique(),
            conditions,
            frozenset(averaged_corruptions(rows)),
            {name: sums for name, (sums, _) in added.items()},
            {name: counts for name, (_, counts) in added.items()},
            clean_sum,
            clean_count,
        )

    def corruptions(self) -> list[str]:
        """Return the corruptions in the rows, starting with the paper's corruptions in the paper's order."""
        return ordered({name for name, _ in self.conditions})

    def error_mean(self, metric: str, corruption: str, severity: int | None = None) -> ErrorMean:
        """Return a mean of the run."""
        if metric not in INTERVAL_METRICS:
            raise unknown_name("metric", metric, INTERVAL_METRICS)
        clean = Mean(self.clean_sum, self.clean_count, np.ones(1))
        if corruption == CLEAN:
            if metric != "epe":
                raise UsageError(metric, "not defined on the clean frames: choose epe")
            return ErrorMean(clean)
        stored = "cre" if metric == "crer" else metric
        share = self._share(stored, corruption, severity)
        columns = np.flatnonzero(share)
        mean, before = (
            Mean(self.sums[name][:, columns], self.counts[name][:, columns], share[columns])
            for name in (stored, "before")
        )
        if metric == "crer":
            return ErrorMean(mean, clean, relative=True)
        return ErrorMean(mean, before if metric == "cre" and before.total.any() else None)

    def statistic(self, metric: str, corruption: str, severity: int | None = None) -> Statistic:
        """Return an `error_mean` as a function of the cluster weights."""
        return self.error_mean(metric, corruption, severity).statistic()

    def mean(self, metric: str, corruption: str, severity: int | None = None) -> float:
        """Return the value of a `statistic`."""
        return float(self.statistic(metric, corruption, severity)(np.ones((1, len(self.clusters)))).theta[0])

    def measured(self, metric: str, corruption: str, severity: int | None = None) -> bool:
        """Whether any image was measured for this mean."""
        if corruption == CLEAN:
            return metric == "epe" and bool(self.clean_count.any())
        if metric == "crer":
            return bool(self.clean_count.any()) and self.measured("cre", corruption, severity)
        return bool(self._share(metric, corruption, severity).any())

    def _share(self, metric: str, corruption: str, severity: int | None) -> Array:
        """Return the weight of each condition in the mean over severities, then corruptions, as float64 (K,)."""
        share = np.zeros(len(self.conditions))
        has_images = self.counts[metric].sum(axis=0) > 0
        measured = self.corruptions()
        of_family = () if corruption in measured else MEMBERS.get(corruption, ())
        averaged = [name for name in measured if name in self.averaged]
        names = averaged if corruption == AVERAGE else of_family or (corruption,)
        of_name = {
            name: [
                k
                for k, (other, level) in enumerate(self.conditions)
                if other == name and has_images[k] and severity in (None, level)
            ]
            for name in names
        }
        there = [columns for columns in of_name.values() if columns]
        for columns in there:
            share[columns] = 1.0 / (len(there) * len(columns))
        return share


def image_errors(rows: pl.DataFrame) -> pl.DataFrame:
    """Tabulate, for each row of a run, the sample, group, corruption, severity and frames_digest, and the image's mean
    errors in pixels, null where nothing could be measured: epe, rcre, cre, and `before`, the clean epe over the same
    pixels as epe."""
    parts = {"epe": MEASURES["epe"], "rcre": MEASURES["rcre"], "before": BEFORE}
    known = {name: pl.when(one.count > 0).then(one.total / one.count) for name, one in parts.items()}
    images = rows.select("sample", "group", "corruption", "severity", "frames_digest", **known)
    seen = images.filter(pl.col("epe").is_not_null(), corruption=CLEAN)["sample"]
    before = pl.when(pl.col("sample").is_in(seen.implode())).then("before")
    return images.with_columns(before=before, cre=pl.col("epe") - before)


def _sums(
    images: pl.DataFrame, name: str, clusters: Sequence[str], conditions: Sequence[Column]
) -> tuple[Array, Array]:
    """Add up a value and count the images with one, per cluster and condition."""
    known = images.filter(pl.col(name).is_not_null())
    column_of = {condition: number for number, condition in enumerate(conditions)}
    columns = [column_of[at] for at in known.select("corruption", "severity").iter_rows()]
    at = np.searchsorted(np.array(clusters, object), known["group"].to_numpy()), np.array(columns, np.intp)
    sums, counts = np.zeros((2, len(clusters), len(conditions)))
    np.add.at(sums, at, known[name].to_numpy())
    np.add.at(counts, at, 1.0)
    return sums, counts
