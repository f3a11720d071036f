"""Sum a run's rows per cluster and condition, the basis of every mean and its resamples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ...core.errors import UsageError, unknown_name
from ...corruptions.registry import MEMBERS, ordered
from ...metrics.means import AVERAGE, averaged_corruptions
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
        dirty = images.filter(pl.col("corruption") != CLEAN)
        conditions = tuple(dirty.select("corruption", "severity").unique().sort("corruption", "severity").iter_rows())
        shape = (len(clusters), len(conditions))
        columns = pl.DataFrame(conditions, schema={"corruption": pl.String, "severity": pl.Int64}, orient="row")
        at = _places(dirty, clusters, columns.with_row_index("_column"))
        sums, counts = {}, {}
        before = (dirty["epe"] - dirty["cre"]).alias("before")
        for values in (dirty["epe"], dirty["cre"], dirty["rcre"], before):
            sums[values.name], counts[values.name] = _sums(values, at, shape)
        clean = images.filter(corruption=CLEAN)
        only = pl.DataFrame({"corruption": [CLEAN], "severity": [0], "_column": [0]})
        clean_sum, clean_count = _sums(clean["epe"], _places(clean, clusters, only), (len(clusters), 1))
        averaged = frozenset(averaged_corruptions(rows))
        samples = images["sample"].n_unique()
        return cls(clusters, samples, conditions, averaged, sums, counts, clean_sum, clean_count)

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
                raise UsageError(f"{metric} of the clean frames is not defined: choose epe")
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
    epe, cre and rcre in pixels, null where nothing could be measured. Both errors in CRE are over the same pixels;
    without ground truth, RCRE is over all pixels."""
    without_truth = pl.col("n_valid").is_null()
    images = rows.select(
        "sample",
        "group",
        "corruption",
        "severity",
        "frames_digest",
        epe=pl.when(pl.col("n_valid") > 0).then(pl.col("epe_sum") / pl.col("n_valid")),
        _before=pl.when(pl.col("n_valid") > 0).then(pl.col("clean_epe_sum") / pl.col("n_valid")),
        rcre=pl.when(pl.coalesce("n_valid", "n_all") > 0).then(
            pl.when(without_truth)
            .then(pl.col("rcre_all_sum") / pl.col("n_all"))
            .otherwise(pl.col("rcre_sum") / pl.col("n_valid"))
        ),
    )
    clean = images.filter(corruption=CLEAN).select("sample", _clean="epe")
    joined = images.join(clean, on="sample", how="left", maintain_order="left")
    moved = pl.when(pl.col("_clean").is_not_null()).then(pl.col("epe") - pl.col("_before"))
    return joined.with_columns(cre=moved).drop("_before", "_clean")


def _places(values: pl.DataFrame, clusters: tuple[str, ...], columns: pl.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the cluster index and the condition index of each value."""
    groups = pl.DataFrame({"group": clusters}, schema={"group": pl.String}).with_row_index("_row")
    at = values.select("group", "corruption", "severity").join(groups, on="group", how="left", maintain_order="left")
    at = at.join(columns, on=["corruption", "severity"], how="left", maintain_order="left")
    return at["_row"].to_numpy(), at["_column"].to_numpy()


def _sums(values: pl.Series, at: tuple[np.ndarray, np.ndarray], shape: tuple[int, int]) -> tuple[Array, Array]:
    known = values.is_not_null().to_numpy()
    sums, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(sums, at, np.where(known, values.fill_null(0.0).to_numpy(), 0.0))
    np.add.at(counts, at, known.astype(np.float64))
    return sums, counts
