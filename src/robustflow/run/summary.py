"""The means of a run with what they cover, and `summary.json`, which contains both."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

import polars as pl

from ..core.types import FrozenFinite
from ..corruptions.registry import IMAGE_PAIR, MEMBERS, family_of, ordered
from ..metrics.cube import AVERAGE, PAPER, Averaging, Cube, Means, means_of_run
from ..metrics.measures import METRICS
from ..metrics.regions import REGIONS
from ..metrics.rows import CLEAN, ROW_KEY, ROW_SCHEMA_VERSION
from .manifest import Cell

SUMMARY_VERSION = 6
"""Version of `summary.json`, incremented when a field is added or changes its meaning."""


class MissingCells(FrozenFinite):
    """The same samples under several conditions: pairs of a corruption and a severity."""

    conditions: list[tuple[str, int]]
    samples: list[str]

    @property
    def count(self) -> int:
        """The number of cells."""
        return len(self.conditions) * len(self.samples)


class Measured(FrozenFinite):
    """What the rows of a run contain, and which corruptions its means cover.

    Attributes:
        missing: samples that are part of the plan but have no row.
        unmeasured: rows without any pixel to measure (no finite prediction or no valid ground truth).
        samples: number of samples.
        n_invalid: number of pixels without a finite prediction, over all rows; excluded from all means.
        corruptions: the severities of each corruption, in table order.
        averaged_over: corruptions included in the means over corruptions: all that were measured, except those that
            leave no ground truth (`Corruption.truth`) if others were run.
        paper_over: the paper's corruptions on this benchmark if all of them were measured; otherwise empty.
    """

    missing: list[MissingCells]
    unmeasured: list[MissingCells]
    samples: int
    n_invalid: int
    corruptions: dict[str, list[int]]
    averaged_over: list[str]
    paper_over: list[str]

    @property
    def complete(self) -> bool:
        """Whether everything planned was measured."""
        return not self.missing and not self.unmeasured

    @property
    def severities(self) -> list[int]:
        """All severities, in ascending order."""
        return sorted({level for levels in self.corruptions.values() for level in levels})


class Averages(NamedTuple):
    """The means of a run and what they cover."""

    means: Means
    measured: Measured

    def mean(self, measure: str, condition: str = AVERAGE, severity: int | None = None) -> float | None:
        """Return a mean; None if nothing was measured."""
        return self.means.get((measure, condition, severity))

    @property
    def has_gaps(self) -> bool:
        """Whether some pixels have no prediction, so that tables need a column `coverage`."""
        shares = (self.mean("coverage", condition) for condition in (CLEAN, *self.measured.corruptions))
        return any(share is not None and share < 1 for share in shares)

    @property
    def without_truth(self) -> list[str]:
        """The corruptions that leave no ground truth (`Corruption.truth`), as far as the means show it."""
        known, averaged = self.mean("epe", CLEAN) is not None, self.measured.averaged_over
        seen = (name for name in self.measured.corruptions if self.mean("rcre", name) is not None)
        return [name for name in seen if name not in averaged or (known and self.mean("epe", name) is None)]

    def document(self, averaging: Averaging) -> dict[str, Any]:
        """Return the means in the form of `summary.json`."""
        measured, conditions = self.measured, {condition for _, condition, _ in self.means}

        def scores(condition: str) -> dict[str, Any]:
            return {metric: self.mean(metric, condition) for metric in METRICS}

        def inside(region: str) -> dict[str, Any]:
            return {name: self.mean(name, region) for name in ("share", "epe_clean", "fl_clean")}

        return scores(AVERAGE) | {
            "version": SUMMARY_VERSION,
            "row_schema": ROW_SCHEMA_VERSION,
            "averaging": averaging,
            "complete": measured.complete,
            **measured.model_dump(include={"missing", "unmeasured", "samples", "n_invalid"}),
            "epe_clean": self.mean("epe", CLEAN),
            "clean_flow_length": self.mean("flow_length", CLEAN),
            "photometric_still": self.mean("photometric_still", CLEAN),
            "clean": scores(CLEAN),
            "averaged_over": measured.averaged_over,
            "corruptions": {
                name: scores(name)
                | {
                    "family": family_of(name),
                    "severities": levels,
                    "by_severity": {m: [self.mean(m, name, level) for level in levels] for m in METRICS},
                }
                for name, levels in measured.corruptions.items()
            },
            "families": {
                family: scores(family)
                for family, members in MEMBERS.items()
                if any(name in members for name in measured.corruptions)
            },
            "regions": {name: scores(name) | inside(name) for name in REGIONS if name in conditions},
            "paper": scores(PAPER) if measured.paper_over else None,
            "paper_over": measured.paper_over,
        }


def summarize(
    rows: pl.DataFrame | pl.LazyFrame,
    averaging: Averaging = "image",
    planned: Iterable[Cell] | None = None,
    *,
    paper: Collection[str] = IMAGE_PAIR,
) -> Averages:
    """Compute the means of a run."""
    cube = Cube.of(rows, MEMBERS, averaging)
    cube.check()
    corruptions = {name: cube.corruptions[name] for name in ordered(cube.corruptions)}
    lost = cube.rows.filter(pl.coalesce("n_valid", "n_all") == 0).select(ROW_KEY).collect()
    every = Counter(dict(zip(cube.conditions, cube.counts.sum(axis=0).tolist(), strict=True)))
    every.subtract(lost.select("corruption", "severity").iter_rows())
    known = [name for name, levels in corruptions.items() if any(every[name, level] for level in levels)]
    in_paper = [name for name in known if name in paper]
    whole = bool(in_paper) and set(in_paper) == set(paper)
    measured = Measured(
        missing=_by_samples(cube.missing(planned)),
        unmeasured=_by_samples(lost.iter_rows()),
        samples=len(cube.samples),
        n_invalid=int(cube.rows.select(pl.col("n_invalid").sum()).collect().item()),
        corruptions=corruptions,
        averaged_over=[name for name in known if name in cube.wholes[AVERAGE]],
        paper_over=in_paper if whole else [],
    )
    return Averages(means_of_run(cube.including({PAPER: in_paper}) if whole else cube), measured)


def _by_samples(cells: Iterable[Any]) -> list[MissingCells]:
    samples: dict[tuple[str, int], list[str]] = defaultdict(list)
    for sample, corruption, severity in cells:
        samples[corruption, severity].append(sample)
    conditions: dict[tuple[str, ...], list[tuple[str, int]]] = defaultdict(list)
    for condition in sorted(samples):
        conditions[tuple(sorted(samples.pop(condition)))].append(condition)
    return [MissingCells(conditions=equal, samples=list(keys)) for keys, equal in conditions.items()]
