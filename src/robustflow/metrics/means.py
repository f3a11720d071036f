"""Average rows: over images, then severities, then corruptions, as in the paper, or over the pixels of all images.

Every mean is `math.fsum(...) / count`, which is exactly rounded and so does not depend on the order of the rows: the
same rows always give the same bits. At most a few columns are in memory at a time.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from .error_maps import crer
from .measures import CLEAN_MEASURES, MEASURES, REGION_MEASURES, Measure, exact_mean
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

MeanKey = tuple[str, str, int | None]
"""(measure, condition, severity): the condition is "clean", "average", "paper", a family, a corruption or a region; the
severity is None for a mean over severities."""
Means = dict[MeanKey, float]
"""The known means; nothing for a mean over nothing, for example without ground truth."""

Places = np.ndarray[Any, np.dtype[np.int32]]
"""Indices of rows."""

_FEW_ROWS = 10_000
"""Up to this number of rows, lazy rows are read once instead of once per column."""


@dataclass(frozen=True)
class RunRows:
    """The rows of one run, and where the rows of each sample and condition are."""

    rows: pl.LazyFrame
    samples: list[str]
    sample_of: Places
    places: dict[tuple[str, int], Places]

    @classmethod
    def of(cls, rows: pl.DataFrame | pl.LazyFrame) -> RunRows:
        """Find the rows of each sample, corruption and severity; one column is read at a time."""
        lazy = rows.lazy()
        if lazy.select(pl.len()).collect().item() <= _FEW_ROWS:
            lazy = lazy.collect().lazy()
        samples, sample_of = _numbered(lazy, "sample")
        corruptions, corruption_of = _numbered(lazy, "corruption")
        severities = lazy.select(pl.col("severity").cast(pl.Int8)).collect().to_series().to_numpy()
        places = {}
        for number, corruption in enumerate(corruptions):
            of_corruption = np.flatnonzero(corruption_of == number).astype(np.int32)
            if corruption == CLEAN:
                places[CLEAN, 0] = of_corruption
                continue
            for severity in np.unique(severities[of_corruption]).tolist():
                places[corruption, severity] = of_corruption[severities[of_corruption] == severity]
        return cls(lazy, samples, sample_of, places)

    @cached_property
    def counts(self) -> np.ndarray:
        """The number of rows of each sample under each condition."""
        count = np.zeros((len(self.samples), len(self.places)), np.int32)
        for number, places in enumerate(self.places.values()):
            count[:, number] = np.bincount(self.sample_of[places], minlength=len(self.samples))
        return count

    @cached_property
    def corruptions(self) -> dict[str, list[int]]:
        """The severities of each corruption, in ascending order; the corruptions by name."""
        levels: dict[str, list[int]] = {}
        for corruption, severity in sorted(at for at in self.places if at[0] != CLEAN):
            levels.setdefault(corruption, []).append(severity)
        return levels

    def averaged(self) -> set[str]:
        """Return the corruptions that `AVERAGE` includes."""
        return averaged_corruptions(self.rows)

    def check(self) -> None:
        """Raise a RunError if the rows are not the rows of one run, or lack measurements of the pixels they count."""
        conditions = list(self.places)
        if (self.counts > 1).any():
            sample, (corruption, severity) = min(
                (self.samples[one], conditions[other]) for one, other in np.argwhere(self.counts > 1).tolist()
            )
            raise RunError(
                sample,
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

    def missing(self, planned: Iterable[tuple[str, str, int]] | None) -> list[tuple[str, str, int]]:
        """Return the planned cells without a row; by default every sample is planned under every condition."""
        samples = {sample: number for number, sample in enumerate(self.samples)}
        conditions = {condition: number for number, condition in enumerate(self.places)}
        if planned is None:
            planned = ((sample, *condition) for sample in samples for condition in {(CLEAN, 0), *conditions})
        return [
            (sample, corruption, severity)
            for sample, corruption, severity in planned
            if sample not in samples
            or (corruption, severity) not in conditions
            or not self.counts[samples[sample], conditions[corruption, severity]]
        ]

    def cells(
        self, measure: Measure, averaging: Averaging = "image", only: Collection[str] = ()
    ) -> dict[tuple[str, int], float]:
        """Return the mean of a measure over the images of each (corruption, severity), where it is known; `only` limits
        the corruptions."""
        counts = self._array(measure.count)
        kept = counts > 0
        if measure.paired:
            seen = self._array(pl.col(measure.paired)) > 0
            with_clean = np.zeros(len(self.samples), bool)
            clean = self.places.get((CLEAN, 0), np.zeros(0, np.int32))
            with_clean[self.sample_of[clean[seen[clean]]]] = True
            kept &= with_clean[self.sample_of]
        totals = self._array(measure.total)
        before = None if measure.minus is None else self._array(measure.minus)
        out = {}
        for at, places in self.places.items():
            some = places[kept[places]]
            if not some.size or (measure.paired and at[0] == CLEAN) or (only and at[0] not in only):
                continue
            value = _over_images(totals[some], counts[some], measure, averaging)
            if before is not None:
                value -= _over_images(before[some], counts[some], measure, averaging)
            if math.isfinite(value):
                out[at] = value
        return out

    def _array(self, value: pl.Expr) -> np.ndarray:
        """Return a value of every row, with 0 where it is missing."""
        return self.rows.select(value.cast(pl.Float64).fill_null(0.0)).collect().to_series().to_numpy()


def _needed() -> list[tuple[str, str]]:
    """List pairs of columns: a count, and a column that has a value in every row in which the count is positive."""
    sums = [(column.count, name) for name, column in COLUMNS.items() if column.count]
    return sums + [(f"n_{region}", "n_valid") for region in REGION_MEASURES]


def _numbered(rows: pl.LazyFrame, column: str) -> tuple[list[str], Places]:
    """Return the distinct names in a column, sorted, and for each row the index of its name."""
    known = rows.select(pl.col(column).unique().sort()).collect().to_series().to_list()
    numbers = rows.select(pl.col(column).cast(pl.Enum(known)).to_physical().cast(pl.Int32)).collect()
    return known, numbers.to_series().to_numpy()


def _over_images(totals: np.ndarray, counts: np.ndarray, measure: Measure, averaging: Averaging) -> float:
    if averaging == "pixel":
        return measure.factor * math.fsum(totals.tolist()) / int(counts.sum())
    return measure.over((measure.factor * totals / counts).tolist())


def averaged_corruptions(rows: pl.DataFrame | pl.LazyFrame) -> set[str]:
    """Return the corruptions that means over corruptions include: those that leave the ground truth unchanged or, if
    there are none, all."""
    names = rows.lazy().filter(pl.col("corruption") != CLEAN).select("corruption", "truth").unique().collect()
    unchanged = names.filter(pl.col("truth").ne_missing("none"))
    return set((names if unchanged.is_empty() else unchanged)["corruption"])


def averaged_rows(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the clean rows and those of `averaged_corruptions`."""
    return rows.filter(pl.col("corruption").is_in([CLEAN, *averaged_corruptions(rows)]))


def clean_mean(rows: pl.DataFrame, measure: Measure) -> float | None:
    """Return the mean of a measure on the clean frames; None if no image has a value."""
    return RunRows.of(rows.filter(corruption=CLEAN)).cells(measure).get((CLEAN, 0))


def means(
    rows: pl.DataFrame | pl.LazyFrame | RunRows,
    groups: Mapping[str, Collection[str]],
    measures: Mapping[str, Measure] = MEASURES,
    averaging: Averaging = "image",
) -> Means:
    """Average measures over images, severities, corruptions, and groups of corruptions such as families. With the EPE
    and the CRE, the CREr is added: the ratio of the mean CRE to the mean clean EPE."""
    if averaging not in get_args(Averaging):
        raise UsageError("averaging", f"unknown '{averaging}': choose from {', '.join(get_args(Averaging))}")
    of_run = rows if isinstance(rows, RunRows) else RunRows.of(rows)
    wholes = {AVERAGE: of_run.averaged(), **groups}
    out: Means = {}
    for name, measure in measures.items():
        cells = of_run.cells(measure, averaging)
        if (clean := cells.pop((CLEAN, 0), None)) is not None:
            out[name, CLEAN, None] = clean
        out |= {(name, *at): value for at, value in cells.items()}
        of_corruption = _averaged((at[0], value) for at, value in sorted(cells.items()))
        by_level: dict[int | None, dict[str, float]] = defaultdict(dict)
        by_level[None] = of_corruption
        for (corruption, severity), value in cells.items():
            by_level[severity][corruption] = value
        out |= {(name, corruption, None): value for corruption, value in of_corruption.items()}
        for level, values in by_level.items():
            out |= {(name, whole, level): value for whole, value in group_means(values, wholes).items()}
    return out | _ratios(out)


def group_means(values: Mapping[str, float], groups: Mapping[str, Collection[str]]) -> dict[str, float]:
    """Average each group over its known members; a group without any is left out."""
    known = {group: [values[name] for name in members if name in values] for group, members in groups.items()}
    return {group: exact_mean(parts) for group, parts in known.items() if parts}


def _averaged(values: Iterable[tuple[str, float]]) -> dict[str, float]:
    of_name: dict[str, list[float]] = {}
    for name, value in values:
        of_name.setdefault(name, []).append(value)
    return {name: exact_mean(parts) for name, parts in of_name.items()}


def _ratios(known: Means) -> Means:
    """Return the CREr of each CRE."""
    clean = known.get(("epe", CLEAN, None))
    ratios = {at: crer(value, clean) for at, value in known.items() if at[0] == "cre"}
    return {("crer", *at[1:]): ratio for at, ratio in ratios.items() if ratio is not None}


def means_of_run(of_run: RunRows, groups: Mapping[str, Collection[str]], averaging: Averaging = "image") -> Means:
    """Return the means of `MEASURES`, those of the clean frames, and those inside each region: over all corruptions,
    and `epe_clean`, `fl_clean` and `share`, the percentage of the valid pixels that are inside."""
    out = means(of_run, groups, MEASURES, averaging)
    for name, measure in CLEAN_MEASURES.items():
        for value in of_run.cells(measure, averaging, [CLEAN]).values():
            out[name, CLEAN, None] = value
    for region, measures in REGION_MEASURES.items():
        count = f"n_{region}"
        if not of_run.rows.select(pl.col(count).sum()).collect().item():
            continue
        inside = means(of_run, {}, measures, averaging)
        for (name, condition, severity), value in inside.items():
            if severity is None and (condition == AVERAGE or (condition == CLEAN and name != "rcre")):
                out[name + "_clean" * (condition == CLEAN), region, None] = value
        clean = of_run.rows.filter((pl.col("corruption") == CLEAN) & pl.col(count).is_not_null())
        n_inside, n_valid = clean.select(pl.col(count, "n_valid").sum()).collect().row(0)
        if n_valid:
            out["share", region, None] = 100.0 * n_inside / n_valid
    return out


def checked_rows(rows: pl.DataFrame | pl.LazyFrame) -> RunRows:
    """Return the rows of a run; raise a RunError if they are not the rows of one run."""
    known = rows.lazy().collect_schema().names()
    if absent := [name for name in ROW_SCHEMA if name not in known]:
        raise RunError(absent[0], "the rows lack this column: they have a different schema; run the benchmark again")
    of_run = RunRows.of(rows)
    of_run.check()
    return of_run
