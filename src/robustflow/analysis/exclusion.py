"""Reasons not to rank a model by robustness, whatever its CRE: it learned nothing, is hardly better than zero flow, or
is insensitive to its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median_low

import polars as pl

from ..benchmarks.facts import is_still
from ..metrics.rows import CLEAN
from ..runs.comparable import sample_set
from ..runs.means import clean_flow_length
from ..runs.run import Run

ACCURATE_BELOW = 0.5
"""The clean EPE of a sound model is below this fraction of zero flow's. A flow with a larger error gains as much by
being shorter as by being right, so little change under corruption means nothing."""
SMALL_MOTION = 1.0
"""Mean length of the true flow in pixels below which sound models may miss `ACCURATE_BELOW` as well: on Middlebury's
RubberWhale (1.26 px) the package's models are off by 0.23 to 0.40 px."""
BLIND_BELOW = 0.001
"""RCRE as a fraction of the length of the clean flow below which a flow hardly depends on the frames. The mildest
severity of a single corruption moves DIS, Farneback and `tiny` by 0.010 to 0.15 of it."""
STILL_BELOW = 0.05
"""Mean length of the clean flow in pixels below which, without ground truth, a model cannot be told from zero flow."""


def exclusion_reasons(run: Run) -> list[str]:
    """The reasons against ranking a run's model by robustness, each as a clause; empty for a sound model.

    A model can change little under corruption because it ignores its frames: random weights, zero flow, a constant.
    """
    reasons = ["its weights are random"] if run.setting == "untrained" else []
    if is_still(run.benchmark):
        return reasons  # zero flow is right, so a flow that ignores the frames is as good as any
    return reasons + run.cached_value("exclusion reasons", list[str], lambda: reasons_from_rows(run.rows))


def exclusions(runs: Sequence[Run]) -> list[str]:
    """Why each run should not be ranked; "" for one that should.

    Without ground truth a short flow has a small RCRE, so a run whose clean flow is less than half as long as that of
    at least half of the others on the same frames is excluded, too.
    """
    reasons = [list(exclusion_reasons(run)) for run in runs]
    lengths: dict[str, dict[int, float]] = {}
    for index, run in enumerate(runs):
        length = run.summary.clean_flow_length
        if length is not None and run.summary.epe_clean is None and not reasons[index]:
            lengths.setdefault(sample_set(run), {})[index] = length
    for of_frames in lengths.values():
        for index, length in of_frames.items():
            others = [other for key, other in of_frames.items() if key != index]
            if others and length < ACCURATE_BELOW * median_low(others):
                reasons[index].append(
                    f"its clean flow is {length:.2f} px long on average, less than half of the "
                    f"{median_low(others):.2f} px of the other models (median)"
                )
    return list(map(" and ".join, reasons))


def reasons_from_rows(rows: pl.DataFrame) -> list[str]:
    """The reasons of `exclusion_reasons` that follow from the rows of a run over moving scenes (columns of
    `ROW_SCHEMA`).

    >>> from robustflow.metrics.rows import rows_frame
    >>> reasons_from_rows(rows_frame([]))
    []
    """
    reasons = []
    if (missed := missed_motion(rows)) is not None:
        epe, still = missed
        why = (
            "motion this small cannot tell a sound model from one that predicts none: measure it on larger motion"
            if still < SMALL_MOTION
            else "a flow that misses the motion has little to lose"
        )
        reasons.append(f"its clean EPE of {epe:.2f} px is not below half of the {still:.2f} px of zero flow ({why})")
    length, moved = clean_flow_length(rows, "image"), _moved(rows)
    if zero_flow_epe(rows) is None and length is not None and length < STILL_BELOW:
        reasons.append(f"its clean flow is {length:.2f} px long on average, so it cannot be told from zero flow")
    if length is not None and moved is not None and moved <= BLIND_BELOW * length:
        reasons.append(
            f"its flow hardly depends on the frames: corruption moves it by {moved:.3f} px of {length:.2f} px"
        )
    return reasons


def missed_motion(rows: pl.DataFrame) -> tuple[float, float] | None:
    """The clean EPE and that of zero flow, pixels, if the first is not below `ACCURATE_BELOW` of the second; None if it
    is, or without ground truth."""
    epe, still = clean_epe(rows), zero_flow_epe(rows)
    if epe is None or still is None or epe < ACCURATE_BELOW * still:
        return None
    return epe, still


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
