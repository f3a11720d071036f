"""Check that rows were measured on frames that others can reproduce, by recomputing the digests from the data.

A row contains a digest of the frames that the model received. Frames depend only on the data, the corruption, its
severity, the seed and the sample's key, so anyone with the data can recompute them without the model.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from ..core.rng import Rng
from ..data.datasets.clips import window_on
from ..metrics.regions import REGIONS
from ..models import ModelSpec
from ..models.base import AnyModel, describe_cell
from .identity import Identity
from .named_model import name_model
from .plan import Unit
from .setup import set_up_frames
from .worker import NoMotion, temporary_worker

TOLERANCE_PX = 0.01
"""Tolerance for the means of one row, because rounding depends on the processor and the library."""

_TRUTH = ("height", "width", "n_valid", "magnitude_sum", *(f"n_{region}" for region in REGIONS))


def recheck(
    identity: Identity,
    rows: pl.DataFrame,
    data: str | Path | None = None,
    *,
    model: ModelSpec | None = None,
    options: dict[str, Any] | None = None,
    count: int = 20,
    seed: int | None = None,
) -> str:
    """Recompute the frames of some rows of a run, and compare their digests and the columns that depend on ground
    truth.
    """
    if count < 1:
        raise UsageError(f"the number of rows to check must be at least 1; got {count}")
    seed = int.from_bytes(os.urandom(4)) if seed is None else seed
    dataset, run_options = set_up_frames(identity, data, options or {})
    predictor: AnyModel = NoMotion()
    if model is not None:
        predictor = name_model(model).model
        measuring = run_options.measuring.model_copy(update={"draws": identity.measuring.draws})
        run_options = replace(run_options, window=window_on(predictor, dataset), measuring=measuring)
    drawn = np.argsort(Rng.of(seed, "recheck").uniforms(rows.height), kind="stable")[:count]
    chosen = rows[sorted(drawn.tolist())]
    known = set(dataset.keys())
    absent = sorted(set(chosen["sample"]) - known)
    if absent:
        raise RunError(f"this dataset has no sample '{absent[0]}' (it has {len(known)}); use the data of the run")
    problems = []
    with temporary_worker(dataset, predictor, run_options) as worker:
        for row in chosen.iter_rows(named=True):
            where = describe_cell(row["sample"], row["corruption"], row["severity"])
            (made,) = worker.run(Unit(row["sample"], row["corruption"], (row["severity"],)))
            if made["frames_digest"] != row["frames_digest"]:
                problems.append(f"{where}: different frames")
            elif made["group"] != row["group"]:
                problems.append(f"{where}: different group")
            elif any(made[column] != row[column] for column in ("truth", "truth_digest")) or (
                row["n_all"] == row["height"] * row["width"] and any(made[c] != row[c] for c in _TRUTH)
            ):
                problems.append(f"{where}: different ground truth")
            elif model is not None and (gap := _largest_difference(made, row)) > TOLERANCE_PX:
                problems.append(f"{where}: this model's error differs by {gap:.3g}")
    if problems:
        raise RunError(
            f"{len(problems)} of {chosen.height} rows do not match these data; first mismatch: {problems[0]}"
        )
    drawn_rows = f"{chosen.height} of {rows.height} rows, drawn with seed {seed}"
    if model is not None:
        return f"{drawn_rows}, were predicted again and agree to within {TOLERANCE_PX} px in mean error"
    return f"{drawn_rows}, match the frames and ground truth of these data"


def _largest_difference(made: dict[str, Any], row: dict[str, Any]) -> float:
    """Return the largest difference between two rows in their mean error, mean change from the clean flow or mean
    spread, in pixels, or in their mean photometric error, in grey levels."""
    gaps = [0.0]
    sums = {"epe_sum": "n_valid", "rcre_all_sum": "n_all", "spread_sum": "n_all", "photometric_sum": "n_photometric"}
    for total, count in sums.items():
        if made[total] is None or row[total] is None:
            gaps.append(0.0 if made[total] is row[total] else math.inf)
        elif bool(made[count]) != bool(row[count]):
            gaps.append(math.inf)
        elif row[count]:
            gaps.append(abs(made[total] / made[count] - row[total] / row[count]))
    return max(gaps)
