"""Compute the row for one (sample, corruption, severity): sums and counts.

All reported results are computed from rows, so a different average, a region or a confidence interval does not require
a second run. CRE is not stored: it is the difference between two errors over the same pixels, `epe_sum` and
`clean_epe_sum`.

Definition of the columns. *Usable* pixels are those where both the prediction and the model's prediction on the clean
frames are finite (for a model that works correctly, all pixels).

- `truth` = what the corruption leaves of the ground truth (`Corruption.truth`); with "none", everything that needs
  ground truth is null.
- `n_valid` = usable pixels with valid ground truth; the denominator of `epe_sum`, `clean_epe_sum`, `rcre_sum`,
  `magnitude_sum`, `fl_count`, `px*_count` and `wauc_sum`. All of these are null if the sample has no ground truth.
- `n_truth` = pixels with valid ground truth, usable or not; `n_valid / n_truth` is the coverage. Null without ground
  truth.
- `clean_epe_sum` = the clean flow's end-point error, summed over the same pixels as `epe_sum`.
- `n_<r>` = pixels of `n_valid` in region r; the denominator of that region's sums. Null if the sample has no such
  region (no ground truth, no occlusion map); 0 if the region is empty.
- `n_all` = usable pixels; the denominator of `rcre_all_sum` and `pred_magnitude_sum`.
- `attack_linf`, `attack_rms` = norms of the attack's perturbation of the 8-bit frames, in grey levels;
  `attack_capped_sum` = the error, clipped to the frame's diagonal, summed over the pixels of `n_valid`; `attack_median`
  = the median error over these pixels, in pixels; `attack_way_gone` = fraction of the distance from the clean flow to
  the target that the attack covered, null without a target; `attack_late_gain` = how much the last quarter of the
  evaluations of the best start raised its score, in units of the attack's loss, null for fewer than eight evaluations;
  `attack_start_spread` = difference between the scores of the best and the worst start, null with a single start (the
  row is that of the best start, the worst case for the model); `attack_evaluations` = number of flows that the attack
  computed; `attack_warnings` = warnings about the attack (`robustflow.attacks.result.WARNINGS`), separated by commas,
  null if there are none. All nine are null except in the rows of attacks.
- `ause`, `confidence_spearman`, `error_at_*`, `oracle_at_*` = quality of the confidence over the pixels of `n_valid`
  (see `confidence`): the area between the sparsification curves in pixels, the rank correlation, and the mean error in
  pixels of the 90, 80, ... 10 % most confident or most accurate pixels. `rejected_count` = pixels of `n_all` that fail
  the forward-backward check. Null in a run without a confidence, or if its confidence source does not define it.
- `spread_sum` = standard deviation of the flow over the draws of the corruption, summed over the pixels of `n_all`, in
  pixels; null in a run with a single draw.
- `photometric_sum` = photometric error of the flow, |frame 1 - frame 2 at the pixel's target| (see `photometric`), in
  grey levels, summed over the `n_photometric` pixels whose target is inside the frame. `photometric_still_sum` = the
  same for zero flow over the same pixels. All are measured on the *clean* frames, also for the flow on corrupted ones.
- `n_invalid` = pixels whose prediction is not finite, out of all height x width pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import DataError
from ..core.types import Flow, Sample
from .error_maps import flow_array
from .photometric import photometric
from .regions import REGIONS, Regions
from .row_sums import row_sums

ROW_SCHEMA_VERSION = 8
"""Version of the row schema, incremented when a column is added or removed, or changes its meaning; part of a run's
identity. Rows with a different version are not read.
"""

CLEAN = "clean"
"""Corruption name in the rows of clean frames; their severity is 0."""

ROW_KEY = ("sample", "corruption", "severity")
"""Columns that together identify a row within a run."""

COVERAGES = (90, 80, 70, 60, 50, 40, 30, 20, 10)
"""Percentages of the pixels for which rows contain the mean error of the most confident and of the most accurate
pixels.
"""

_NUMBER: type[pl.DataType] = pl.Float64
ON_REQUEST: dict[str, type[pl.DataType]] = {
    "ause": _NUMBER,
    "confidence_spearman": _NUMBER,
    "rejected_count": pl.Int64,
    **{f"{curve}_at_{share}": _NUMBER for curve in ("error", "oracle") for share in COVERAGES},
    "spread_sum": _NUMBER,
}
"""Columns that are null except in runs with a confidence or with several draws."""

ROW_SCHEMA: dict[str, type[pl.DataType]] = {
    "sample": pl.String,
    "group": pl.String,
    "corruption": pl.String,
    "severity": pl.Int64,
    "truth": pl.String,
    "frames_digest": pl.String,
    "truth_digest": pl.String,
    "height": pl.Int64,
    "width": pl.Int64,
    "n_invalid": pl.Int64,
    "n_all": pl.Int64,
    "rcre_all_sum": pl.Float64,
    "pred_magnitude_sum": pl.Float64,
    "n_photometric": pl.Int64,
    "photometric_sum": pl.Float64,
    "photometric_still_sum": pl.Float64,
    "n_truth": pl.Int64,
    "n_valid": pl.Int64,
    "epe_sum": pl.Float64,
    "clean_epe_sum": pl.Float64,
    "rcre_sum": pl.Float64,
    "magnitude_sum": pl.Float64,
    "fl_count": pl.Int64,
    "px1_count": pl.Int64,
    "px3_count": pl.Int64,
    "px5_count": pl.Int64,
    "wauc_sum": pl.Float64,
    "attack_linf": pl.Float64,
    "attack_rms": pl.Float64,
    "attack_capped_sum": pl.Float64,
    "attack_median": pl.Float64,
    "attack_way_gone": pl.Float64,
    "attack_late_gain": pl.Float64,
    "attack_start_spread": pl.Float64,
    "attack_evaluations": pl.Int64,
    "attack_warnings": pl.String,
} | {
    f"{column}_{region}": dtype
    for region in REGIONS
    for column, dtype in (
        ("n", pl.Int64),
        ("epe_sum", pl.Float64),
        ("clean_epe_sum", pl.Float64),
        ("rcre_sum", pl.Float64),
        ("fl_count", pl.Int64),
    )
}
ROW_SCHEMA |= ON_REQUEST
"""Columns of the rows and their types, in order. Sums are in pixels, except `wauc_sum` (1 per pixel without error) and
the photometric sums (grey levels).
"""

SIGNED = ("confidence_spearman",)
"""Columns that may be negative."""

_WITHOUT_TRUTH = ("n_invalid", "n_all", "rcre_all_sum", "pred_magnitude_sum")
"""Counts and sums that exist for a sample without ground truth."""


def measure(
    pred: Flow,
    clean_pred: Flow,
    sample: Sample,
    regions: Regions | None,
    *,
    corruption: str = CLEAN,
    severity: int = 0,
    truth: str = "unchanged",
    frames_digest: str = "",
) -> dict[str, Any]:
    """Compute one row: the errors of `pred`, and its distance from `clean_pred`.

    Args:
        pred: float32 (H, W, 2), the model's flow on the corrupted frames (on the clean frames for the clean row).
        clean_pred: float32 (H, W, 2), the model's flow on the clean frames.
        sample: the sample, with its ground truth if available.
        regions: regions of the sample, `Regions.of(sample)`, computed once and shared by all rows of the sample.
        corruption, severity, truth, frames_digest: values copied into the row; the digest is the hexadecimal BLAKE3
            hash of the two input frames (for a multi-frame model, of the evaluated pair in the clip). The hash of the
            ground truth is taken from the regions.

    Returns:
        A dict with exactly the columns of `ROW_SCHEMA`; a value is None if it needs ground truth or a region that the
        sample does not have.

    Raises:
        DataError: the prediction is not float32 (H, W, 2) of the frames' size, or the regions do not match the sample.

    >>> import numpy as np
    >>> frame, ones = np.zeros((4, 6, 3), np.uint8), np.ones((4, 6, 2), np.float32)
    >>> sample = Sample("a", (frame, frame), 0 * ones, np.ones((4, 6), bool))
    >>> row = measure(4 * ones, 1 * ones, sample, Regions.of(sample), corruption="fog", severity=3)
    >>> round(row["epe_sum"] / row["n_valid"], 3), round(row["rcre_sum"] / row["n_valid"], 3), row["n_occ"]
    (5.657, 4.243, None)
    """
    pred = flow_array(pred)
    if pred.shape[:2] != sample.shape or (regions is not None and regions.valid.shape != sample.shape):
        raise DataError(
            f"sample '{sample.key}' is {sample.shape[0]}x{sample.shape[1]}: the prediction "
            f"(shape {pred.shape}) and the regions must have that size"
        )
    if (regions is None) != (sample.flow is None):
        raise DataError(f"sample '{sample.key}': the regions belong to a different sample; pass Regions.of(sample)")
    sums = row_sums(pred, clean_pred, sample.flow, regions)
    n_photometric, photometric_sum, still_sum, _ = photometric(sample.frames[0], sample.frames[1], pred)
    row: dict[str, Any] = dict.fromkeys(ROW_SCHEMA)
    row |= {
        "sample": sample.key,
        "group": sample.group,
        "corruption": corruption,
        "severity": severity,
        "truth": truth,
        "frames_digest": frames_digest,
        "height": sample.shape[0],
        "width": sample.shape[1],
        "n_photometric": n_photometric,
        "photometric_sum": photometric_sum,
        "photometric_still_sum": still_sum,
    }
    if regions is None:
        return row | {name: sums.whole[name] for name in _WITHOUT_TRUTH}
    row |= sums.whole
    row |= {"truth_digest": regions.truth_digest, "n_truth": int(np.count_nonzero(regions.valid))}
    for name in regions.names:
        row |= {f"{column}_{name}": value for column, value in sums.region(name).items()}
    return row


def rows_frame(rows: Iterable[dict[str, Any]]) -> pl.DataFrame:
    """Convert rows to a polars DataFrame with the columns and types of `ROW_SCHEMA`.

    >>> rows_frame([]).height
    0
    """
    return pl.DataFrame(list(rows), schema=ROW_SCHEMA, strict=True, orient="row")
