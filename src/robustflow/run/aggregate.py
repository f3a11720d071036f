"""Average rows, by the paper's rule and over pooled pixels.

The paper averages over the pixels of an image, then images, then severities, then corruptions (section "Robustness
Metrics"). A run's mean is over the requested corruptions; the paper's mean, over its 20 or 24 corruptions, is added if
all of them were run. Every mean is computed as `math.fsum(...) / count`, which is exactly rounded and so does not
depend on the order of the rows: the same rows always give a byte-identical summary.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from typing import Any, get_args

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from ..corruptions.registry import FAMILIES, IMAGE_PAIR, family_of, ordered
from ..metrics.regions import REGIONS
from ..metrics.rows import CLEAN, ROW_KEY, ROW_SCHEMA
from ..metrics.summary import METRICS, Averaging, CorruptionScores, MissingCells, RegionScores, Scores, Summary
from .cells import Cell
from .means import (
    WHOLE,
    RowPlaces,
    averaged_corruptions,
    clean_flow_length,
    clean_mean,
    grouped_by_family,
    mean_scores,
    scores_by_condition,
)

_REGION_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "fl_count")
_NEEDS: tuple[tuple[str, str], ...] = (
    *((count, total) for total, count, _ in WHOLE.values() if count in ROW_SCHEMA),
    *(("n_valid", name) for name in ("rcre_sum", "clean_epe_sum", "n_truth")),
    *((f"n_{region}", f"{total}_{region}") for region in REGIONS for total in _REGION_SUMS),
    *((f"n_{region}", "n_valid") for region in REGIONS),
)
"""Pairs of columns: a count, and a column that has a value in every row in which the count is positive."""
_FEW_ROWS = 10_000
"""Up to this number of rows, lazy rows are read once instead of once per column."""


def summarize(
    rows: pl.DataFrame | pl.LazyFrame,
    averaging: Averaging = "image",
    planned: Iterable[Cell] | None = None,
    *,
    paper: Collection[str] = IMAGE_PAIR,
) -> Summary:
    """Compute the means of a run."""
    if averaging not in get_args(Averaging):
        raise UsageError(f"unknown averaging '{averaging}': choose from {', '.join(get_args(Averaging))}")
    lazy = rows.lazy()
    if lazy.select(pl.len()).collect().item() <= _FEW_ROWS:
        rows = lazy.collect()
        lazy = rows.lazy()
    where = _checked(lazy)
    missing = _missing(where, planned)
    with_truth = pl.coalesce("n_valid", "n_all")
    unmeasured = _units(lazy.filter(with_truth == 0).select(ROW_KEY).collect().iter_rows())

    whole = rows.with_columns(
        rcre_sum=pl.when(pl.col("n_valid").is_null()).then("rcre_all_sum").otherwise("rcre_sum"),
        rcre_n=with_truth,
        n_covered=with_truth,
        n_spread=pl.when(pl.col("spread_sum").is_not_null()).then("n_all"),
        n_wanted=pl.when(pl.col("n_valid").is_null()).then(pl.col("height") * pl.col("width")).otherwise("n_truth"),
    )
    clean, by_condition = scores_by_condition(whole, where, WHOLE | {"rcre": ("rcre_sum", "rcre_n", 1.0)}, averaging)
    corruptions = _corruptions(by_condition, clean)
    averaged = averaged_corruptions(lazy)
    overall = mean_scores([scores for name, scores in corruptions.items() if name in averaged], clean)
    in_paper = [name for name in corruptions if name in paper]
    families = {family: mean_scores(parts, clean) for family, parts in grouped_by_family(corruptions).items()}
    return Summary(
        **overall.model_dump(),
        averaging=averaging,
        complete=not missing and not unmeasured,
        missing=missing,
        unmeasured=unmeasured,
        samples=len(where.samples),
        n_invalid=int(lazy.select(pl.col("n_invalid").sum()).collect().item()),
        epe_clean=clean.epe,
        clean_flow_length=clean_flow_length(rows, averaging),
        photometric_still=clean_mean(rows, "photometric_still_sum", "n_photometric", averaging),
        clean=clean,
        averaged_over=[name for name in corruptions if name in averaged],
        corruptions=corruptions,
        families=families,
        regions=_regions(rows, where, averaging),
        paper=mean_scores([corruptions[name] for name in in_paper], clean) if set(in_paper) == set(paper) else None,
        paper_over=in_paper if set(in_paper) == set(paper) else [],
    )


def _checked(rows: pl.LazyFrame) -> RowPlaces:
    """Find the rows of each condition; raise a RunError if they are not the rows of one run."""
    known = rows.collect_schema().names()
    absent = [name for name in ROW_SCHEMA if name not in known]
    if absent:
        raise RunError(f"rows lack the column '{absent[0]}': they have a different schema; run the benchmark again")
    where = RowPlaces.of(rows)
    samples, conditions, count = where.row_counts()
    if (count > 1).any():
        sample, (corruption, severity) = min(
            (list(samples)[one], list(conditions)[other]) for one, other in np.argwhere(count > 1).tolist()
        )
        raise RunError(
            f"rows of sample '{sample}', {corruption} severity {severity} occur twice: "
            "the rows of two runs were mixed; summarise one run at a time"
        )
    lacking = [(pl.col(count) > 0).fill_null(False) & pl.col(total).is_null() for count, total in _NEEDS]
    few = (lacking[start : start + 8] for start in range(0, len(lacking), 8))  # limits the number of columns in memory
    if any(rows.select(pl.any_horizontal(some).any()).collect().item() for some in few):
        damaged = rows.filter(pl.any_horizontal(lacking)).select(ROW_KEY).sort(ROW_KEY).head(1).collect()
        sample, corruption, severity = damaged.row(0)
        raise RunError(
            f"the row of sample '{sample}', {corruption} severity {severity} counts pixels, but lacks their "
            "measurements: the rows were damaged or changed; run the benchmark again"
        )
    return where


def _missing(where: RowPlaces, planned: Iterable[Cell] | None) -> list[MissingCells]:
    """Return the planned cells without a row; by default every sample is planned under every condition in the rows."""
    samples, conditions, count = where.row_counts()
    if planned is None:
        planned = ((sample, *condition) for sample in samples for condition in {(CLEAN, 0), *conditions})
    return _units(
        {
            (sample, corruption, severity)
            for sample, corruption, severity in planned
            if sample not in samples
            or (corruption, severity) not in conditions
            or not count[samples[sample], conditions[corruption, severity]]
        }
    )


def _units(units: Iterable[Any]) -> list[MissingCells]:
    by_condition: dict[tuple[str, int], list[str]] = defaultdict(list)
    for sample, corruption, severity in units:
        by_condition[corruption, severity].append(sample)
    return [
        MissingCells(corruption=corruption, severity=severity, samples=sorted(by_condition[corruption, severity]))
        for corruption, severity in sorted(by_condition)
    ]


def _corruptions(by_condition: dict[tuple[str, int], Scores], clean: Scores) -> dict[str, CorruptionScores]:
    by_corruption: dict[str, dict[int, Scores]] = defaultdict(dict)
    for (corruption, severity), scores in sorted(by_condition.items(), key=lambda item: item[0]):
        by_corruption[corruption][severity] = scores
    return {
        name: CorruptionScores(
            **mean_scores(list(by_corruption[name].values()), clean).model_dump(),
            family=family_of(name),
            severities=list(by_corruption[name]),
            by_severity={m: [getattr(scores, m) for scores in by_corruption[name].values()] for m in METRICS},
        )
        for name in ordered(by_corruption)
    }


def _regions(rows: pl.DataFrame | pl.LazyFrame, where: RowPlaces, averaging: Averaging) -> dict[str, RegionScores]:
    out = {}
    lazy = rows.lazy()
    for region in REGIONS:
        count = f"n_{region}"
        if not lazy.select(pl.col(count).sum()).collect().item():
            continue
        columns = {
            "epe": (f"epe_sum_{region}", count, 1.0),
            "rcre": (f"rcre_sum_{region}", count, 1.0),
            "fl": (f"fl_count_{region}", count, 100.0),
        }
        clean, by_condition = scores_by_condition(rows, where, columns, averaging)
        overall = mean_scores([*_corruptions(by_condition, clean).values()], clean)
        clean_rows = lazy.filter((pl.col("corruption") == CLEAN) & pl.col(count).is_not_null())
        inside, n_valid = clean_rows.select(pl.col(count, "n_valid").sum()).collect().row(0)
        out[region] = RegionScores(
            **overall.model_dump(),
            share=100.0 * inside / n_valid if n_valid else None,
            epe_clean=clean.epe,
            fl_clean=clean.fl,
        )
    return out


def summary_in_order(summary: Summary) -> Summary:
    """Sort the keys of a summary loaded from a file into the order of a computed summary."""
    return summary.model_copy(
        update={
            "corruptions": {name: summary.corruptions[name] for name in ordered(summary.corruptions)},
            "families": {name: summary.families[name] for name in FAMILIES if name in summary.families},
            "regions": {name: summary.regions[name] for name in REGIONS if name in summary.regions},
        }
    )
