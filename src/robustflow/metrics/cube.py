"""`Cube`: the value of any measure for each image under each condition, and the means over them, as in the paper.

A measure is one polars expression over the rows and one reshape; the columns of one measure are in memory at a time.
A scope says what a mean averages: images, then severities, then corruptions. Exact means and the weights of resampling
both follow from it. Every mean is `math.fsum(...) / count`, which is exactly rounded and so does not depend on the
order of the rows: the same rows always give the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
import polars as pl

from ..core.errors import RunError, UsageError
from .error_maps import LARGEST_ERROR, cre, crer
from .measures import CLEAN_MEASURES, MEASURES, REGION_MEASURES, Average, Increase, Measure, Ratio, exact_mean
from .rows import CLEAN, COLUMNS, ROW_KEY, ROW_SCHEMA

Averaging = Literal["image", "pixel"]
"""`image` (as in the paper): average over the pixels of each image, then over the images. `pixel`: average over the
pixels of all images together. In both cases, the results are then averaged over severities and finally over
corruptions.
"""

AVERAGE = "average"
"""The condition of a mean over corruptions."""
PAPER = "paper"
"""The condition of a mean over exactly the paper's corruptions, which exists only if all of them were run. Only this
mean is comparable with published averages."""

Scope = tuple[str, int | None]
"""(condition, severity): the condition is "clean", "average", "paper", a family or a corruption; the severity is None
for a mean over severities."""
MeanKey = tuple[str, str, int | None]
"""(measure, condition, severity) of a mean; the condition may also be a region of the image."""
Means = dict[MeanKey, float]
"""The known means; nothing for a mean over nothing, for example without ground truth."""

Images = npt.NDArray[np.float64]
"""Values by image and condition, float64 (S, K); NaN where nothing was measured, infinite where it is undefined."""

_FEW_ROWS = 10_000
"""Up to this number of rows, lazy rows are read once instead of once per column."""
_MOST_EMPTY = 2**24
"""Number of cells above which a cube of which less than a quarter was measured is refused."""


@dataclass(frozen=True, eq=False)
class Cube:
    """The rows of one run, by image and condition.

    Attributes:
        rows: the rows, in any order.
        samples: names of the images (S), sorted.
        groups: names of the clusters (G), sorted.
        cluster: index of the cluster of each image, int32 (S,).
        conditions: (corruption, severity) of each column (K), sorted; the clean frames have severity 0.
        cell: place of each row, `sample * K + column`, int64 (N,).
        wholes: what means over several corruptions include, by condition.
        averaging: how pixels are averaged.
    """

    rows: pl.LazyFrame
    samples: tuple[str, ...]
    groups: tuple[str, ...]
    cluster: npt.NDArray[np.int32]
    conditions: tuple[tuple[str, int], ...]
    cell: npt.NDArray[np.int64]
    wholes: Mapping[str, Collection[str]]
    averaging: Averaging = "image"
    _seen: dict[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    _of_columns: dict[Measure, dict[int, float]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        rows: pl.DataFrame | pl.LazyFrame,
        wholes: Mapping[str, Collection[str]] | None = None,
        averaging: Averaging = "image",
    ) -> Cube:
        """Find the image and the condition of each row. `wholes` are groups of corruptions, such as families."""
        if averaging not in get_args(Averaging):
            raise UsageError("averaging", f"unknown '{averaging}': choose from {', '.join(get_args(Averaging))}")
        lazy = rows.lazy()
        columns = lazy.collect_schema().names()
        if absent := [name for name in ROW_SCHEMA if name not in columns]:
            raise RunError(
                absent[0], "the rows lack this column: they have a different schema; run the benchmark again"
            )
        count = lazy.select(pl.len()).collect().item()
        if count <= _FEW_ROWS:
            lazy = lazy.collect().lazy()
        samples, sample = _numbered(lazy, "sample")
        groups, group = _numbered(lazy, "group")
        cluster = np.zeros(len(samples), np.int32)
        cluster[sample] = group
        corruptions, corruption = _numbered(lazy, "corruption")
        severity = lazy.select(pl.col("severity").cast(pl.Int64)).collect().to_series().to_numpy()
        base = int(severity.max(initial=0)) + 1
        codes, column = np.unique(corruption * base + severity, return_inverse=True)
        conditions = tuple((corruptions[code // base], code % base) for code in codes.tolist())
        cells = len(samples) * len(conditions)
        if cells > max(4 * count, _MOST_EMPTY):
            raise RunError(
                "rows",
                f"only {count} of {cells} combinations of {len(samples)} samples and {len(conditions)} conditions were "
                "measured; summarise samples with different conditions separately",
            )
        whole = {AVERAGE: averaged_corruptions(lazy), **(wholes or {})}
        cell = sample.astype(np.int64) * len(conditions) + column
        return cls(lazy, tuple(samples), tuple(groups), cluster, conditions, cell, whole, averaging)

    def including(self, wholes: Mapping[str, Collection[str]]) -> Cube:
        """Return the cube with further groups of corruptions."""
        return replace(self, wholes={**self.wholes, **wholes})

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of images and of conditions."""
        return len(self.samples), len(self.conditions)

    @cached_property
    def counts(self) -> npt.NDArray[np.int64]:
        """The number of rows of each image under each condition, int64 (S, K)."""
        return np.bincount(self.cell, minlength=math.prod(self.shape)).reshape(self.shape)

    @cached_property
    def corruptions(self) -> dict[str, list[int]]:
        """The severities of each corruption, in ascending order; the corruptions by name."""
        levels: dict[str, list[int]] = {}
        for corruption, severity in self.conditions:
            if corruption != CLEAN:
                levels.setdefault(corruption, []).append(severity)
        return levels

    @cached_property
    def clean(self) -> int | None:
        """The column of the clean frames."""
        return self.conditions.index((CLEAN, 0)) if (CLEAN, 0) in self.conditions else None

    @cached_property
    def alike(self) -> npt.NDArray[np.int64]:
        """A number for each image, int64 (S,), equal for images with equal clean frames."""
        known = (pl.col("corruption") == CLEAN) & (pl.col("frames_digest") != "")
        of_clean = self.rows.select(known.fill_null(False)).collect().to_series().to_numpy()
        digests = self.rows.filter(known).select("frames_digest").collect().to_series().to_numpy()
        alike = np.arange(len(self.samples))
        _, first, number = np.unique(digests, return_index=True, return_inverse=True)
        places = self.cell[of_clean] // self.shape[1]
        alike[places] = places[first][number]
        return alike

    @property
    def scopes(self) -> list[Scope]:
        """Every scope that a mean may have."""
        levels = sorted({severity for _, severity in self.conditions if severity})
        wholes = [name for name in self.wholes if name not in self.corruptions]
        return [(CLEAN, None), *((name, at) for name in (*self.corruptions, *wholes) for at in (*levels, None))]

    def scope(self, condition: str, severity: int | None, known: Container[int]) -> list[list[int]]:
        """Return the known columns that a mean averages: for each corruption, those of its severities. This is the
        paper's averaging: first over severities, then over corruptions, of what was measured."""
        if condition == CLEAN:
            return [[self.clean]] if self.clean is not None and self.clean in known else []
        names = {condition} if condition in self.corruptions else self.wholes.get(condition, ())
        columns: dict[str, list[int]] = {}
        for column, (name, level) in enumerate(self.conditions):
            if name in names and severity in (None, level) and column in known:
                columns.setdefault(name, []).append(column)
        return list(columns.values())

    def images(self, measure: Average | Increase) -> Images:
        """Return the value of each image under each condition."""
        if isinstance(measure, Increase):
            return increase(self.images(measure.after), self.images(measure.before))
        ratio = measure.factor * _number(measure.total) / measure.count.cast(pl.Float64)
        return self._dense(measure, ratio.fill_nan(math.inf))

    def _dense(self, measure: Average, value: pl.Expr) -> Images:
        """Arrange a value of the rows that a measure includes by image and condition."""
        known = pl.when(measure.count > 0).then(value).fill_null(math.nan)
        dense = np.full(math.prod(self.shape), np.nan)
        dense[self.cell] = self.rows.select(known).collect().to_series().to_numpy()
        dense = dense.reshape(self.shape)
        if measure.paired:
            dense[~self._on_clean(measure.paired)] = np.nan
            if self.clean is not None:
                dense[:, self.clean] = np.nan
        return dense

    def _on_clean(self, count: str) -> npt.NDArray[np.bool_]:
        """Whether a count of each image is positive on the clean frames, bool (S,)."""
        if count not in self._seen:
            positive = (pl.col("corruption") == CLEAN) & (pl.col(count) > 0).fill_null(False)
            places = self.cell[self.rows.select(positive).collect().to_series().to_numpy()]
            self._seen[count] = np.bincount(places // self.shape[1], minlength=self.shape[0]) > 0
        return self._seen[count]

    def known(self, measure: Average | Increase) -> Mapping[int, float]:
        """Return the mean over the images of each column in which the measure was measured; infinite where it is
        undefined."""
        if measure not in self._of_columns:
            arrays = [self._parts(part) for part in measure.parts]
            seen = np.logical_and.reduce([~np.isnan(values) for values, *_ in arrays])
            means = {}
            for column in np.flatnonzero(seen.any(axis=0)).tolist():
                some = seen[:, column]
                after, *before = (
                    _over_images(part, *(array[some, column] for array in of_part))
                    for part, of_part in zip(measure.parts, arrays, strict=True)
                )
                mean = cre(after, before[0]) if before else after
                means[column] = mean if mean is not None and math.isfinite(mean) else math.inf
            self._of_columns[measure] = means
        return self._of_columns[measure]

    def _parts(self, measure: Average) -> tuple[Images, ...]:
        """Return what `_over_images` averages: the values, or the totals and their counts."""
        if self.averaging == "image":
            return (self.images(measure),)
        return self._dense(measure, _number(measure.total)), self._dense(measure, measure.count.cast(pl.Float64))

    def mean(self, measure: Measure, condition: str, severity: int | None = None) -> float | None:
        """Return a mean; None if nothing was measured, or if it is undefined under one of the conditions."""
        if isinstance(measure, Ratio):
            return crer(self.mean(measure.above, condition, severity), self.mean(measure.below, CLEAN))
        means = self.known(measure)
        scope = self.scope(condition, severity, means)
        if not scope or any(math.isinf(means[k]) for columns in scope for k in columns):
            return None
        return exact_mean([exact_mean([means[k] for k in columns]) for columns in scope])

    def means(self, measures: Mapping[str, Measure], scopes: Iterable[Scope] | None = None) -> Means:
        """Return the known means of measures over scopes, by default over all."""
        scopes = self.scopes if scopes is None else list(scopes)
        every = {(name, *at): self.mean(measure, *at) for name, measure in measures.items() for at in scopes}
        return {key: value for key, value in every.items() if value is not None}

    def check(self) -> None:
        """Raise a RunError if the rows are not the rows of one run, or lack measurements of the pixels they count."""
        if (self.counts > 1).any():
            sample, column = np.argwhere(self.counts > 1)[0].tolist()
            corruption, severity = self.conditions[column]
            raise RunError(
                self.samples[sample],
                f"its rows of {corruption} severity {severity} occur twice: the rows of two runs were mixed; summarise "
                "one run at a time",
            )
        lacking = [(pl.col(count) > 0).fill_null(False) & pl.col(total).is_null() for count, total in _needed()]
        few = (lacking[start : start + 8] for start in range(0, len(lacking), 8))  # limits the columns in memory
        if any(self.rows.select(pl.any_horizontal(some).any()).collect().item() for some in few):
            damaged = self.rows.filter(pl.any_horizontal(lacking)).select(ROW_KEY).sort(ROW_KEY).head(1).collect()
            sample, corruption, severity = damaged.row(0)
            raise RunError(
                sample,
                f"its row of {corruption} severity {severity} counts pixels, but lacks their measurements: the rows "
                "were damaged or changed; run the benchmark again",
            )

    def missing(self, planned: Iterable[tuple[str, str, int]] | None) -> Iterator[tuple[str, str, int]]:
        """Yield the planned cells without a row; by default every sample is planned under every condition."""
        samples = {sample: number for number, sample in enumerate(self.samples)}
        conditions = {condition: number for number, condition in enumerate(self.conditions)}
        if planned is None:
            planned = ((sample, *condition) for sample in samples for condition in {(CLEAN, 0), *conditions})
        for sample, corruption, severity in planned:
            if (
                sample not in samples
                or (corruption, severity) not in conditions
                or not self.counts[samples[sample], conditions[corruption, severity]]
            ):
                yield sample, corruption, severity


def increase(after: Images, before: Images) -> Images:
    """Return by how much values rise; infinite where one is above `LARGEST_ERROR`."""
    with np.errstate(invalid="ignore"):
        return np.where(np.maximum(after, before) > LARGEST_ERROR, math.inf, after - before)


def _number(value: pl.Expr) -> pl.Expr:
    return value.cast(pl.Float64).fill_null(0.0)


def _needed() -> list[tuple[str, str]]:
    """List pairs of columns: a count, and a column that has a value in every row in which the count is positive."""
    sums = [(column.count, name) for name, column in COLUMNS.items() if column.count]
    return sums + [(f"n_{region}", "n_valid") for region in REGION_MEASURES]


def _numbered(rows: pl.LazyFrame, column: str) -> tuple[list[str], npt.NDArray[np.int32]]:
    """Return the distinct names in a column, sorted, and for each row the index of its name."""
    values = rows.select(pl.col(column).unique().sort()).collect().to_series().to_list()
    numbers = rows.select(pl.col(column).cast(pl.Enum(values)).to_physical().cast(pl.Int32)).collect()
    return values, numbers.to_series().to_numpy()


def _over_images(measure: Average, values: np.ndarray, counts: np.ndarray | None = None) -> float:
    if counts is None:
        return measure.over(values.tolist())
    return measure.factor * math.fsum(values.tolist()) / int(counts.sum())


def averaged_corruptions(rows: pl.DataFrame | pl.LazyFrame) -> set[str]:
    """Return the corruptions that means over corruptions include: those that leave the ground truth unchanged or, if
    there are none, all."""
    names = rows.lazy().filter(pl.col("corruption") != CLEAN).select("corruption", "truth").unique().collect()
    unchanged = names.filter(pl.col("truth").ne_missing("none"))
    return set((names if unchanged.is_empty() else unchanged)["corruption"])


def averaged_rows(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the clean rows and those of `averaged_corruptions`."""
    return rows.filter(pl.col("corruption").is_in([CLEAN, *averaged_corruptions(rows)]))


def means_of_run(cube: Cube) -> Means:
    """Return the means of `MEASURES`, those of the clean frames, and those inside each region: over all corruptions,
    and `epe_clean`, `fl_clean` and `share`, the percentage of the valid pixels that are inside."""
    out = cube.means(MEASURES) | cube.means(CLEAN_MEASURES, [(CLEAN, None)])
    pooled = replace(cube, averaging="pixel", _of_columns={})
    for region, measures in REGION_MEASURES.items():
        (rcre,) = measures["rcre"].parts
        if not cube.known(rcre):
            continue
        inside = {(name, region, None): cube.mean(measure, AVERAGE) for name, measure in measures.items()}
        inside |= {(f"{name}_clean", region, None): cube.mean(measures[name], CLEAN) for name in ("epe", "fl")}
        inside["share", region, None] = pooled.mean(measures["share"], CLEAN)
        out |= {key: value for key, value in inside.items() if value is not None}
    return out
