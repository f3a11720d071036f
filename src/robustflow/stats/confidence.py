"""Measure how well a model's confidence predicts its errors, by corruption family and severity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from statistics import fmean

import polars as pl

from ..corruptions.registry import MEMBERS
from ..metrics.means import averaged_rows
from ..metrics.rows import CLEAN, COVERAGES
from ..run.run import Run
from .results import AVERAGE


@dataclass(frozen=True)
class ConfidenceScore:
    """Scores of a model's confidence under one condition, averaged over images, then severities, then corruptions."""

    family: str
    severity: int | None
    ause: float | None
    ause_normalised: float | None
    error_80: float | None
    error_50: float | None
    spearman: float | None
    rejected: float | None
    by_confidence: tuple[float, ...] = ()
    by_error: tuple[float, ...] = ()


def confidence_scores(run: Run) -> list[ConfidenceScore]:
    """Score a run's confidence on the clean frames, over all corruptions, for each family, and for each family at each
    severity; empty if the run has no confidence. Corruptions without a family count only towards the average."""
    rows = run.rows.filter(pl.col("ause").is_not_null() | pl.col("rejected_count").is_not_null())
    return [_score(family, severity, part) for family, severity, part in _conditions(rows) if part.height]


def _conditions(rows: pl.DataFrame) -> Iterator[tuple[str, int | None, pl.DataFrame]]:
    yield CLEAN, None, rows.filter(corruption=CLEAN)
    corrupted = rows.filter(pl.col("corruption") != CLEAN)
    yield AVERAGE, None, averaged_rows(corrupted)
    for family, names in MEMBERS.items():
        part = corrupted.filter(pl.col("corruption").is_in(names))
        yield family, None, part
        for severity in part["severity"].unique().sort():
            yield family, severity, part.filter(severity=severity)


def _score(family: str, severity: int | None, rows: pl.DataFrame) -> ConfidenceScore:
    epe = pl.col("epe_sum") / pl.col("n_valid")
    curves = [
        tuple(
            mean
            for value in (epe, *(pl.col(f"{curve}_at_{share}") for share in COVERAGES))
            if (mean := _mean(rows.filter(pl.col("ause").is_not_null()), value)) is not None
        )
        for curve in ("error", "oracle")
    ]
    return ConfidenceScore(
        family=family,
        severity=severity,
        ause=_mean(rows, pl.col("ause")),
        ause_normalised=_mean(rows, pl.col("ause") / epe),
        error_80=_mean(rows, pl.col("error_at_80")),
        error_50=_mean(rows, pl.col("error_at_50")),
        spearman=_mean(rows, pl.col("confidence_spearman")),
        rejected=_mean(rows, 100 * pl.col("rejected_count") / pl.col("n_all")),
        by_confidence=curves[0],
        by_error=curves[1],
    )


def _mean(rows: pl.DataFrame, value: pl.Expr) -> float | None:
    """Average over images, then severities, then corruptions, as in a run's summary; images without a finite value are
    left out."""
    known = rows.select("corruption", "severity", value=value).filter(pl.col("value").is_finite())
    of_corruption: dict[str, list[float]] = {}
    for corruption, _, values in known.group_by("corruption", "severity").agg("value").iter_rows():
        of_corruption.setdefault(corruption, []).append(fmean(values))
    return fmean(map(fmean, of_corruption.values())) if of_corruption else None
