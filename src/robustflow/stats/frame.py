"""The results frame: every number of runs as one table, of which tables, figures and exports show a part."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import polars as pl

from ..corruptions.registry import MEMBERS
from ..metrics.means import AVERAGE, MeanKey, Means, means
from ..metrics.measures import CONFIDENCE, METRICS, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.comparable import named_runs, sample_set
from ..run.run import Run
from .attacks import attack_scores
from .ranking import partial_spearman, spearman
from .run_results import run_setting
from .uncertainty.intervals import interval_ends

RESULTS_SCHEMA: dict[str, type[pl.DataType]] = {
    "benchmark": pl.String,
    "model": pl.String,
    "sample_set": pl.String,
    "setting": pl.String,
    "measure": pl.String,
    "condition": pl.String,
    "severity": pl.Int64,
    "value": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "pairs": pl.Int64,
    "source": pl.String,
}
"""`condition` is "clean", "average" (over corruptions), "paper" (over exactly the paper's corruptions), a family, a
corruption, a region of the image, or an attack; `severity` is null for a mean over severities. `low` and `high` are the
ends of the 95 % interval, where one was computed. Models of one `sample_set` measured the same frames and may be
compared. `source` is "measured" or "verified record"."""

KINDS = ("means", "confidence", "uncoupled", "attacks")
"""Parts of the frame: the means of `robustflow.metrics.MEASURES`, and the measures of confidence, of robustness beside
accuracy, and of attacks."""

LEAST_IMAGES = 5
"""Minimum number of images for a correlation."""


def results_frame(runs: Sequence[Run], kinds: Collection[str] = KINDS, *, intervals: bool = True) -> pl.DataFrame:
    """Return the numbers of runs, one per row (`RESULTS_SCHEMA`); what was not measured has no row. Computing intervals
    takes about a second for each run that has not stored them."""
    parts = []
    for name, run in named_runs(runs).items():
        values = [(*key, value) for kind in kinds for key, value in _NUMBERS[kind](run).items()]
        part = pl.DataFrame(values, schema=_VALUES, orient="row").with_columns(
            benchmark=pl.lit(run.benchmark),
            model=pl.lit(name),
            sample_set=pl.lit(sample_set(run)),
            setting=pl.lit(run_setting(run)),
            pairs=pl.lit(run.measured.samples, pl.Int64),
            source=pl.lit("verified record" if run.record else "measured"),
        )
        ends = [(*key, *pair) for key, pair in interval_ends(run).items()] if intervals and "means" in kinds else []
        known = pl.DataFrame(ends, schema=_ENDS, orient="row").with_columns(severity=pl.lit(None, pl.Int64))
        part = part.join(known, on=["measure", "condition", "severity"], how="left", nulls_equal=True)
        parts.append(part.select([*RESULTS_SCHEMA]))
    return pl.concat(parts) if parts else pl.DataFrame(schema=RESULTS_SCHEMA)


_VALUES = {name: RESULTS_SCHEMA[name] for name in ("measure", "condition", "severity", "value")}
_ENDS = {name: RESULTS_SCHEMA[name] for name in ("measure", "condition", "low", "high")}


def confidence_means(rows: pl.DataFrame) -> Means:
    """Return how well the confidence predicts errors, also by family and severity; empty if the run has none."""
    known = rows.filter(pl.col("ause").is_not_null() | pl.col("rejected_count").is_not_null())
    return means(known, MEMBERS, CONFIDENCE) if known.height else {}


def uncoupled_means(rows: pl.DataFrame) -> Means:
    """Return measures of robustness that depend less on accuracy than CRE (`UNCOUPLED`), and the rank correlation over
    images of the corrupted and the clean EPE, also given the motion."""
    return means(rows, MEMBERS, UNCOUPLED) | dict(_correlations(rows))


def _correlations(rows: pl.DataFrame) -> Iterator[tuple[MeanKey, float]]:
    n = pl.col("n_valid")
    known = rows.filter(n > 0)
    images = known.filter(pl.col("corruption") != CLEAN).join(known.filter(corruption=CLEAN), on="sample", how="semi")
    for condition in (AVERAGE, *images["corruption"].unique().sort()):
        part = images if condition == AVERAGE else images.filter(corruption=condition)
        per_image = (pl.col(total) / n for total in ("epe_sum", "clean_epe_sum", "magnitude_sum"))
        each = part.group_by("sample", maintain_order=True).agg(value.mean() for value in per_image)
        if each.height < LEAST_IMAGES:
            continue
        epe, before, motion = (each[name].to_list() for name in each.columns[1:])
        found = {"rank_correlation": spearman(epe, before)}
        found["rank_correlation_given_motion"] = partial_spearman(epe, before, motion)
        yield from (((name, condition, None), value) for name, value in found.items() if value is not None)


def attack_means(run: Run) -> Means:
    """Return the numbers of `attack_scores`, with the prefix "attack_" except for the metrics, and the number of pairs
    with each warning as "warning KEY"."""
    out: dict[MeanKey, float] = {}
    for score in attack_scores(run):
        at = score["attack"], score["severity"]
        numbers: dict[str, Any] = {
            name if name in METRICS else f"attack_{name}": value
            for name, value in score.items()
            if isinstance(value, int | float) and name not in ("severity", "samples")
        }
        numbers |= {f"warning {key}": count for key, count in score["warnings"].items()}
        out |= {(name, *at): float(value) for name, value in numbers.items()}
    return out


_NUMBERS = {
    "means": lambda run: run.means,
    "confidence": lambda run: confidence_means(run.rows),
    "uncoupled": lambda run: uncoupled_means(run.rows),
    "attacks": attack_means,
}
