"""Reasons not to call a model robust, whatever its CRE: nothing learned, no better than zero flow, or insensitive to
its frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import polars as pl

from ..metrics.rows import CLEAN
from ..runs.run import Run
from .run_names import run_names
from .scores import sample_set

BLIND_BELOW = 0.01
"""Mean RCRE in pixels below which a flow hardly depends on the frames; the flow of a model that uses them moves ten
times as much even under the mildest corruptions."""


def doubts(run: Run) -> list[str]:
    """The reasons against ranking a run's model by robustness, each as a clause; empty for a sound model.

    A model can change little under corruption because it ignores its frames: random weights, zero flow, a constant.
    """
    reasons = ["its weights are random"] if run.setting == "untrained" else []
    return reasons + run.fact("doubts", list[str], lambda: doubts_from_rows(run.rows))


def doubted_runs(runs: Sequence[Run]) -> dict[tuple[str, str], str]:
    """(sample set, name) -> why a run should not be ranked, for the runs with such a reason."""
    reasons = {
        (sample_set(run), name): " and ".join(doubts(run)) for name, run in zip(run_names(runs), runs, strict=True)
    }
    return {key: reason for key, reason in reasons.items() if reason}


def sound_results(results: pl.DataFrame, doubted: Mapping[tuple[str, str], str]) -> pl.DataFrame:
    """Results (columns `sample_set` and `model` among others) without those of doubted runs, for statements about
    models in general."""
    left_out = pl.DataFrame(list(doubted), schema={"sample_set": pl.String, "model": pl.String}, orient="row")
    return results.join(left_out, on=["sample_set", "model"], how="anti", maintain_order="left")


def doubts_from_rows(rows: pl.DataFrame) -> list[str]:
    """The reasons of `doubts` that follow from the rows of a run (columns of `robustflow.metrics.rows.ROW_SCHEMA`).

    >>> from robustflow.metrics.rows import rows_frame
    >>> doubts_from_rows(rows_frame([]))
    []
    """
    reasons = []
    epe, still = clean_epe(rows), zero_flow_epe(rows)
    if epe is not None and still is not None and epe >= still:
        reasons.append(f"its clean EPE of {epe:.2f} px is not below the {still:.2f} px of zero flow")
    moved = _moved(rows)
    if moved is not None and moved < BLIND_BELOW:
        reasons.append(f"its flow hardly depends on the frames: corruption moves it by {moved:.3f} px")
    return reasons


def clean_epe(rows: pl.DataFrame) -> float | None:
    """Mean over images of the EPE on the clean frames, pixels; None without ground truth."""
    return _mean_over_images(rows.filter(pl.col("corruption") == CLEAN), "epe_sum", "n_valid")


def zero_flow_epe(rows: pl.DataFrame) -> float | None:
    """The EPE of a model that predicts zero flow, pixels: the mean length of the ground truth; None without it."""
    return _mean_over_images(rows.filter(pl.col("corruption") == CLEAN), "magnitude_sum", "n_valid")


def _moved(rows: pl.DataFrame) -> float | None:
    """Mean RCRE over all pixels of the corrupted pairs whose frames are not the clean ones."""
    clean = rows.filter(pl.col("corruption") == CLEAN).select("sample", _clean="frames_digest")
    corrupted = rows.filter(pl.col("corruption") != CLEAN).join(clean, on="sample")
    return _mean_over_images(corrupted.filter(pl.col("frames_digest") != pl.col("_clean")), "rcre_all_sum", "n_all")


def _mean_over_images(rows: pl.DataFrame, total: str, count: str) -> float | None:
    images = rows.filter(pl.col(count) > 0)
    return math.fsum(images[total] / images[count]) / images.height if images.height else None
