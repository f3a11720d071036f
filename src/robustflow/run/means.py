"""Average values over families of corruptions. Compute means over images, and means of those means, exactly and
regardless of order: `math.fsum(...) / count`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import polars as pl

from ..corruptions.registry import MEMBERS
from ..metrics.error_maps import cre, crer
from ..metrics.rows import CLEAN
from ..metrics.summary import METRICS, Averaging, Scores

T = TypeVar("T")


def grouped_by_family(values: Mapping[str, T]) -> dict[str, list[T]]:
    """Group values by family of corruptions, in the paper's order, without empty families and without corruptions that
    have no family.

    >>> grouped_by_family({"snow": 2, "fog": 1, "elastic_transform": 3})
    {'weather': [1, 2]}
    """
    measured = {family: [values[name] for name in names if name in values] for family, names in MEMBERS.items()}
    return {family: members for family, members in measured.items() if members}


def family_crer(cre: Mapping[str, float], clean: float | None) -> dict[str, float]:
    """Return the CREr of each family: the mean CRE of its measured corruptions, divided by the clean EPE; empty if the
    clean EPE is 0 or unknown.
    """
    return {family: mean / clean for family, mean in family_means(cre).items()} if clean else {}


def family_means(values: Mapping[str, float]) -> dict[str, float]:
    """Average each family over its measured corruptions.

    >>> family_means({"snow": 2.0, "fog": 1.0})
    {'weather': 1.5}
    """
    return {family: math.fsum(members) / len(members) for family, members in grouped_by_family(values).items()}


WHOLE = {
    "epe": ("epe_sum", "n_valid", 1.0),
    "rcre_all": ("rcre_all_sum", "n_all", 1.0),
    "fl": ("fl_count", "n_valid", 100.0),
    "px1": ("px1_count", "n_valid", 100.0),
    "px3": ("px3_count", "n_valid", 100.0),
    "px5": ("px5_count", "n_valid", 100.0),
    "wauc": ("wauc_sum", "n_valid", 100.0),
    "photometric": ("photometric_sum", "n_photometric", 1.0),
    "coverage": ("n_covered", "n_wanted", 1.0),
    "spread": ("spread_sum", "n_spread", 1.0),
}
"""For each metric: (column of its sum, column of its count, factor)."""

MetricColumns = dict[str, tuple[str, str, float]]
Places = np.ndarray[Any, np.dtype[np.int32]]
"""Indices of rows."""


@dataclass(frozen=True)
class RowPlaces:
    """The row numbers of each sample and condition."""

    samples: list[str]
    sample_of: Places
    places: dict[tuple[str, int], Places]

    @classmethod
    def of(cls, rows: pl.LazyFrame) -> RowPlaces:
        """Find the row numbers of each sample, corruption and severity; one column is read at a time."""
        samples, sample_of = _numbered(rows, "sample")
        corruptions, corruption_of = _numbered(rows, "corruption")
        severities = rows.select(pl.col("severity").cast(pl.Int8)).collect().to_series().to_numpy()
        out = {}
        for number, corruption in enumerate(corruptions):
            rows_of_corruption = np.flatnonzero(corruption_of == number).astype(np.int32)
            if corruption == CLEAN:
                out[CLEAN, 0] = rows_of_corruption
                continue
            for severity in np.unique(severities[rows_of_corruption]).tolist():
                out[corruption, severity] = rows_of_corruption[severities[rows_of_corruption] == severity]
        return cls(samples, sample_of, out)

    def row_counts(self) -> tuple[dict[str, int], dict[tuple[str, int], int], np.ndarray]:
        """Return the index of each sample and condition, and the number of rows of each sample under each condition."""
        count = np.zeros((len(self.samples), len(self.places)), np.int32)
        for number, places in enumerate(self.places.values()):
            count[:, number] = np.bincount(self.sample_of[places], minlength=len(self.samples))
        numbers = {condition: number for number, condition in enumerate(self.places)}
        return {sample: number for number, sample in enumerate(self.samples)}, numbers, count


def averaged_corruptions(rows: pl.DataFrame | pl.LazyFrame) -> set[str]:
    """Return the corruptions that means over corruptions include: those that leave the ground truth unchanged or, if
    there are none, all."""
    names = rows.lazy().filter(pl.col("corruption") != CLEAN).select("corruption", "truth").unique().collect()
    unchanged = names.filter(pl.col("truth").ne_missing("none"))
    return set((names if unchanged.is_empty() else unchanged)["corruption"])


def averaged_rows(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the clean rows and those of `averaged_corruptions`."""
    return rows.filter(pl.col("corruption").is_in([CLEAN, *averaged_corruptions(rows)]))


def _numbered(rows: pl.LazyFrame, column: str) -> tuple[list[str], Places]:
    """Return the distinct names in a column, sorted, and for each row the index of its name."""
    known = rows.select(pl.col(column).unique().sort()).collect().to_series().to_list()
    numbers = rows.select(pl.col(column).cast(pl.Enum(known)).to_physical().cast(pl.Int32)).collect()
    return known, numbers.to_series().to_numpy()


def scores_by_condition(
    rows: pl.DataFrame | pl.LazyFrame, where: RowPlaces, columns: MetricColumns, averaging: Averaging
) -> tuple[Scores, dict[tuple[str, int], Scores]]:
    """Compute the scores on the clean frames, and at each (corruption, severity)."""
    means = {metric: _means(rows, where.places, sums, averaging) for metric, sums in columns.items()}
    total, count, factor = columns["epe"]
    seen, with_clean = _array(rows, count) > 0, np.zeros(len(where.samples), bool)
    clean_places = where.places.get((CLEAN, 0), np.zeros(0, np.int32))
    with_clean[where.sample_of[clean_places[seen[clean_places]]]] = True
    both = {at: places[seen[places] & with_clean[where.sample_of[places]]] for at, places in where.places.items()}
    epe = _means(rows, both, (total, count, factor), averaging)
    before = _means(rows, both, (f"clean_{total}", count, 1.0), averaging)
    scores = {at: Scores(**{metric: known[at] for metric, known in means.items()}) for at in where.places}
    clean = scores.pop((CLEAN, 0), Scores())
    moved = {at: cre(epe[at], before[at]) for at in scores}
    return clean, {
        at: known.model_copy(update={"cre": moved[at], "crer": crer(moved[at], clean.epe)})
        for at, known in scores.items()
    }


def _means(
    rows: pl.DataFrame | pl.LazyFrame,
    places: dict[tuple[str, int], Places],
    columns: tuple[str, str, float],
    averaging: Averaging,
) -> dict[tuple[str, int], float | None]:
    """Return the mean of one metric for each condition; only its two columns are in memory."""
    total, count, factor = columns
    sums, counts = _array(rows, total), _array(rows, count)
    return {at: _mean_over(sums[indices], counts[indices], factor, averaging) for at, indices in places.items()}


def _array(rows: pl.DataFrame | pl.LazyFrame, column: str) -> np.ndarray:
    """Return a column of all rows, with 0 for missing values."""
    if isinstance(rows, pl.DataFrame):
        return rows[column].fill_null(0).to_numpy()
    return rows.select(pl.col(column).fill_null(0)).collect().to_series().to_numpy()


def _mean_over(sums: np.ndarray, counts: np.ndarray, factor: float, averaging: Averaging) -> float | None:
    """Return the mean of a metric over images, without images that have no pixel to measure."""
    sums, counts = sums[counts > 0], counts[counts > 0]
    if not counts.size:
        return None
    if averaging == "image":
        return math.fsum((factor * sums / counts).tolist()) / counts.size
    return factor * math.fsum(sums.tolist()) / int(counts.sum())


def image_mean(rows: pl.DataFrame | pl.LazyFrame, total: str, count: str) -> float | None:
    """Return the mean over images of `total` / `count`, two columns; None if no image has a count."""
    return _mean_over(_array(rows, total), _array(rows, count), 1.0, "image")


def clean_flow_length(rows: pl.DataFrame | pl.LazyFrame, averaging: Averaging = "image") -> float | None:
    """Return the mean length of the predicted flow on the clean frames, in pixels, over all predicted pixels; None if
    there are none."""
    return clean_mean(rows, "pred_magnitude_sum", "n_all", averaging)


def clean_mean(
    rows: pl.DataFrame | pl.LazyFrame, total: str, count: str, averaging: Averaging = "image"
) -> float | None:
    """Return the mean of `total` / `count`, two columns, over the clean rows; None if no image has a count."""
    clean = rows.lazy().filter(corruption=CLEAN)
    return _mean_over(_array(clean, total), _array(clean, count), 1.0, averaging)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def mean_scores(parts: Sequence[Scores], clean: Scores) -> Scores:
    """Return the mean of each metric over severities or corruptions; CREr is the ratio of the means."""
    means = {metric: _mean([getattr(part, metric) for part in parts]) for metric in METRICS}
    return Scores(**means | {"crer": crer(means["cre"], clean.epe)})
