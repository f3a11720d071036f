"""Choose which cells of a run to draw: the worst cell of the worst sample, and the median cell of the median sample.

A sample's score is its CRE over all corruptions of the run; if the run has no ground truth, its RCRE. The scores are
computed from rows, so the choice is the same on every machine.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from statistics import fmean
from typing import Any, Literal, TypeVar

import polars as pl

from ..metrics.robustness import cre as cre_of
from ..metrics.rows import CLEAN, ROW_KEY
from .means import averaged_rows

Kind = Literal["worst", "median"]

_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "n_valid", "rcre_all_sum", "n_all")

T = TypeVar("T", bound=tuple[Any, ...])


@dataclass(frozen=True)
class CellScores:
    """The scores of one cell, in pixels. EPE and CRE are None without ground truth; RCRE is None if no pixel can be
    compared."""

    epe: float | None
    cre: float | None
    rcre: float | None


@dataclass(frozen=True)
class ExampleCell:
    """A cell to draw, and the reason for drawing it."""

    kind: Kind
    key: str
    corruption: str
    severity: int
    scores: CellScores


def example_cells(rows: pl.DataFrame) -> list[ExampleCell]:
    """Find the worst cell of the worst sample and the median cell of the median sample in a run's rows."""
    cells = (
        averaged_rows(rows)
        .filter(pl.col("corruption") != CLEAN)
        .select(*ROW_KEY, *_SUMS)
        .sort(ROW_KEY)
        .iter_rows(named=True)
    )
    scored = {(row["sample"], row["corruption"], row["severity"]): cell_scores(row) for row in cells}
    metric = "cre" if any(scores.cre is not None for scores in scored.values()) else "rcre"
    values = {cell: getattr(scores, metric) for cell, scores in scored.items() if getattr(scores, metric) is not None}
    if not values:
        return []
    of_sample: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for (key, corruption, _), value in values.items():
        of_sample[key][corruption].append(value)
    # as in the paper: over severities, then over corruptions
    samples = {(key,): fmean(map(fmean, by_corruption.values())) for key, by_corruption in of_sample.items()}
    chosen: list[ExampleCell] = []
    for kind, pick in (("worst", _worst), ("median", _median)):
        (key,) = pick(samples)
        cell = pick({cell: value for cell, value in values.items() if cell[0] == key})
        chosen.append(ExampleCell(kind, *cell, scored[cell]))  # type: ignore[arg-type]  # kind is one of the two
    return chosen


def cell_scores(row: dict[str, Any]) -> CellScores:
    """Compute EPE, CRE and RCRE of one row."""
    n = row["n_valid"]
    epe, before = _mean(row["epe_sum"], n), _mean(row["clean_epe_sum"], n)
    rcre = _mean(row["rcre_all_sum"], row["n_all"]) if n is None else _mean(row["rcre_sum"], n)
    return CellScores(epe, cre_of(epe, before), rcre)


def _mean(total: float | None, count: int | None) -> float | None:
    return total / count if count and total is not None else None


def _worst(values: dict[T, float]) -> T:
    return min(values, key=lambda name: (-values[name], name))


def _median(values: dict[T, float]) -> T:
    order = sorted(values, key=lambda name: (values[name], name))
    return order[(len(order) - 1) // 2]
