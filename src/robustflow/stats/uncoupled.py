"""Robustness metrics that depend less on accuracy than the paper's: ratios of errors, medians over images, the increase
in Fl, and the correlation of clean and corrupted errors given the motion.

CRE is EPE - clean EPE, so it contains the clean EPE with which it is compared, and a mean over images is dominated by
the few with large errors. docs/design/metrics.md has the formulae and explains the limits of each metric.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any

import polars as pl

from ..core.errors import unknown_name
from ..corruptions.registry import ordered
from ..metrics.rows import CLEAN
from .ranking import LEAST_MODELS, partial_spearman, spearman
from .results import AVERAGE

LEAST_IMAGES = 5
"""Minimum number of images for a correlation."""


@dataclass(frozen=True)
class UncoupledScores:
    """Scores of one condition, or the mean over conditions; None if they cannot be computed."""

    log_ratio: float | None = None
    median_log_ratio: float | None = None
    median_cre: float | None = None
    fl_increase: float | None = None


UNCOUPLED = tuple(field.name for field in fields(UncoupledScores))


@dataclass(frozen=True)
class Correlation:
    """Spearman correlation of the corrupted and the clean EPE over images."""

    images: int
    rho: float | None
    given_motion: float | None


@dataclass(frozen=True)
class Uncoupled:
    """The result of `uncoupled`."""

    overall: UncoupledScores
    corruptions: dict[str, UncoupledScores]
    by_condition: dict[tuple[str, int], UncoupledScores]
    correlation: dict[str, Correlation]
    left_out: int

    def table(self, metric: str = "log_ratio") -> pl.DataFrame:
        """Tabulate one metric of `UNCOUPLED` by corruption and severity."""
        if metric not in UNCOUPLED:
            raise unknown_name("metric", metric, UNCOUPLED)
        severities = sorted({severity for _, severity in self.by_condition})
        records = [
            (
                name,
                *(getattr(self.by_condition.get((name, severity)), metric, None) for severity in severities),
                getattr(scores, metric),
            )
            for name, scores in self.corruptions.items()
        ]
        schema: dict[str, type[pl.DataType]] = {"corruption": pl.String}
        schema |= {str(severity): pl.Float64 for severity in severities} | {"mean": pl.Float64}
        return pl.DataFrame(records, schema=schema, orient="row")


def uncoupled(rows: pl.DataFrame) -> Uncoupled:
    """Compute the scores from the rows of a run."""
    images = _images(rows)
    positive = (pl.col("epe") > 0) & (pl.col("before") > 0)
    ratio = (pl.col("epe") / pl.col("before")).log()
    images = images.with_columns(ratio=pl.when(positive).then(ratio))
    by_condition: dict[tuple[str, int], UncoupledScores] = {}
    for key, group in images.partition_by("corruption", "severity", as_dict=True, maintain_order=True).items():
        corruption, severity = key
        by_condition[corruption, severity] = _scores(group)
    order = ordered({corruption for corruption, _ in by_condition})
    corruptions = {
        name: _mean_scores([scores for (of, _), scores in by_condition.items() if of == name]) for name in order
    }
    return Uncoupled(
        _mean_scores(list(corruptions.values())),
        corruptions,
        by_condition,
        _correlations(images, order),
        int(images["ratio"].null_count()),
    )


@dataclass(frozen=True)
class Coupling:
    """Spearman correlations with the clean EPE over models."""

    models: int
    cre: float | None
    log_ratio: float | None


def coupling(clean: Sequence[float], cre: Sequence[float], log_ratio: Sequence[float]) -> Coupling | None:
    """Measure how strongly two robustness metrics correlate with the clean EPE over models; None with fewer than
    `LEAST_MODELS` models.
    """
    if len(clean) < LEAST_MODELS:
        return None
    return Coupling(len(clean), spearman(clean, cre), spearman(clean, log_ratio))


def _images(rows: pl.DataFrame) -> pl.DataFrame:
    """Tabulate the corrupted rows that have ground truth: EPE, clean EPE over the same pixels, Fl of both, motion."""
    counted = rows.filter(pl.col("n_valid") > 0)
    clean = counted.filter(pl.col("corruption") == CLEAN).select("sample", _fl="fl_count", _n="n_valid")
    counted = counted.filter(pl.col("corruption") != CLEAN).join(clean, on="sample", maintain_order="left")
    n = pl.col("n_valid")
    return counted.select(
        "sample",
        "corruption",
        "severity",
        epe=pl.col("epe_sum") / n,
        before=pl.col("clean_epe_sum") / n,
        motion=pl.col("magnitude_sum") / n,
        fl=pl.when(n == pl.col("_n")).then(100.0 * (pl.col("fl_count") - pl.col("_fl")) / n),
    )


def _scores(images: pl.DataFrame) -> UncoupledScores:
    return UncoupledScores(
        log_ratio=_number(images["ratio"].mean()),
        median_log_ratio=_number(images["ratio"].median()),
        median_cre=_number((images["epe"] - images["before"]).median()),
        fl_increase=None if images["fl"].null_count() else _number(images["fl"].mean()),
    )


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def _mean_scores(parts: Sequence[UncoupledScores]) -> UncoupledScores:
    means = []
    for values in zip(*map(astuple, parts), strict=True):
        known = [value for value in values if value is not None]
        means.append(math.fsum(known) / len(known) if known else None)
    return UncoupledScores(*means)


def _correlations(images: pl.DataFrame, order: Sequence[str]) -> dict[str, Correlation]:
    parts: Mapping[str, pl.DataFrame] = {name: images.filter(corruption=name) for name in order}
    correlations = {name: _correlation(part) for name, part in {**parts, AVERAGE: images}.items()}
    return {name: one for name, one in correlations.items() if one is not None}


def _correlation(images: pl.DataFrame) -> Correlation | None:
    """Correlate the mean errors of images; the clean error is over the same pixels as the corrupted one."""
    each = images.group_by("sample", maintain_order=True).agg(pl.col("epe", "before", "motion").mean())
    if each.height < LEAST_IMAGES:
        return None
    epe, before, motion = (each[name].to_list() for name in ("epe", "before", "motion"))
    return Correlation(each.height, spearman(epe, before), partial_spearman(epe, before, motion))
