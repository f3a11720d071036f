"""Sum a run's rows per cluster and condition, the basis of every mean and its resamples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ...corruptions.registry import MEMBERS, ordered
from ...metrics.cube import AVERAGE, averaged_corruptions
from ...metrics.measures import MEASURES
from ...metrics.rows import CLEAN
from .statistic import Array, ErrorMean, Mean, of_data

INTERVAL_METRICS = ("epe", "cre", "crer", "rcre")


@dataclass(frozen=True, eq=False)
class ClusterSums:
    """Per-image errors of one run, added up per cluster.

    Attributes:
        clusters: names of the clusters, sorted.
        images: number of images.
        conditions: (corruption, severity) of each column, also of the clean frames.
        averaged: corruptions that means over corruptions include.
        sums: for each error of `image_errors`, its sums and the numbers of images with a value, float64 (G, K) each.
    """

    clusters: tuple[str, ...]
    images: int
    conditions: tuple[tuple[str, int], ...]
    averaged: frozenset[str]
    sums: dict[str, tuple[Array, Array]]

    @classmethod
    def of(cls, rows: pl.DataFrame) -> ClusterSums:
        """Sum the rows of one run (`robustflow.metrics.rows.ROW_SCHEMA`). Images without valid pixels are left out,
        as in the run's summary."""
        images = image_errors(rows)
        clusters, conditions = (
            images["group"].unique().sort(),
            images.select("corruption", "severity").unique().sort(pl.all()),
        )
        conditions = conditions.with_row_index("column")
        images = images.join(conditions, on=["corruption", "severity"], maintain_order="left")
        images = images.with_columns(row=clusters.search_sorted(images["group"]))
        sums: dict[str, tuple[Array, Array]] = {}
        for name in ("epe", "cre", "rcre", "before"):
            known = images.drop_nulls(name)
            total, count = np.zeros((2, clusters.len(), conditions.height))
            at = known["row"].to_numpy(), known["column"].to_numpy()
            np.add.at(total, at, known[name].to_numpy())
            np.add.at(count, at, 1.0)
            sums[name] = total, count
        of_columns = tuple(conditions.select("corruption", "severity").iter_rows())
        return cls(
            tuple(clusters), images["sample"].n_unique(), of_columns, frozenset(averaged_corruptions(rows)), sums
        )

    def corruptions(self) -> list[str]:
        """Return the corruptions in the rows, starting with the paper's corruptions in the paper's order."""
        return ordered({name for name, _ in self.conditions if name != CLEAN})

    def error_mean(self, metric: str, corruption: str, severity: int | None = None) -> ErrorMean:
        """Return a mean of the run, as a function of the cluster weights."""
        stored = "cre" if metric == "crer" else metric
        share = self._share(stored, corruption, severity)
        if metric == "crer":
            return ErrorMean(
                self._mean(stored, share), self._mean("epe", self._share("epe", CLEAN, None)), relative=True
            )
        over = self._mean("before", share) if metric == "cre" else None
        return ErrorMean(self._mean(stored, share), over if over is not None and over.total.any() else None)

    def mean(self, metric: str, corruption: str, severity: int | None = None) -> float:
        """Return the value of an `error_mean`."""
        return of_data(self.error_mean(metric, corruption, severity), len(self.clusters)).value

    def measured(self, metric: str, corruption: str, severity: int | None = None) -> bool:
        """Whether any image was measured for this mean."""
        if metric == "crer":
            return self.measured("epe", CLEAN) and self.measured("cre", corruption, severity)
        return bool(self._share(metric, corruption, severity).any())

    def _mean(self, name: str, share: Array) -> Mean:
        columns = np.flatnonzero(share)
        total, count = self.sums[name]
        return Mean(total[:, columns], count[:, columns], share[columns])

    def _share(self, metric: str, corruption: str, severity: int | None) -> Array:
        """Return the weight of each condition in the mean over severities, then corruptions, as float64 (K,)."""
        share = np.zeros(len(self.conditions))
        has_images = self.sums[metric][1].sum(axis=0) > 0
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
    parts = {name: MEASURES[name].parts[0] for name in ("epe", "rcre")} | {"before": MEASURES["cre"].parts[1]}
    known = {name: pl.when(one.count > 0).then(one.total / one.count) for name, one in parts.items()}
    images = rows.select("sample", "group", "corruption", "severity", "frames_digest", **known)
    seen = images.filter(pl.col("epe").is_not_null(), corruption=CLEAN)["sample"]
    before = pl.when(pl.col("sample").is_in(seen.implode())).then("before")
    return images.with_columns(before=before, cre=pl.col("epe") - before)
