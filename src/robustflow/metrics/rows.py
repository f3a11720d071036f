"""The columns of the rows, and the row of one (sample, corruption, severity): counts, and sums over pixels.

All reported results are computed from rows, so a different average, a region or a confidence interval does not require
a second run. CRE is not stored: it is the difference between two errors over the same pixels, `epe_sum` and
`clean_epe_sum`.

All sums are computed in one pass over the pixels. Each adds its pixels sequentially in row-major order, in float64, and
uses only +, -, x, / and square roots, which are exactly rounded, so it is bit-identical on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from ..core.compiled import njit_late
from ..core.errors import DataError
from ..core.types import Flow, Sample
from .error_maps import WAUC_UNIT, dense, flow_array, flow_pair, is_fl_outlier, wauc_points
from .photometric import photometric
from .regions import LABELS, MEMBERS, OUTSIDE, REGIONS, Regions

CLEAN = "clean"
"""Corruption name in the rows of clean frames; their severity is 0."""

ROW_SCHEMA_VERSION = 9
"""Version of the row schema, incremented when a column is added or removed, or changes its meaning; part of a run's
identity. Rows with a different version are not read.
"""

ROW_KEY = ("sample", "corruption", "severity")
"""Columns that together identify a row within a run."""

COVERAGES = (90, 80, 70, 60, 50, 40, 30, 20, 10)
"""Percentages of the pixels for which rows contain the mean error of the most confident and of the most accurate
pixels.
"""


@dataclass(frozen=True)
class RowColumn:
    """A column of the rows: its type, its meaning, and for a sum the count of its pixels."""

    kind: type[pl.DataType]
    meaning: str
    count: str = ""
    signed: bool = False


_TEXT, _COUNT, _NUMBER = pl.String, pl.Int64, pl.Float64

COLUMNS: dict[str, RowColumn] = {
    "sample": RowColumn(_TEXT, "The sample's key, the same on every machine."),
    "group": RowColumn(_TEXT, "Name shared by samples that are not independent (one video); otherwise the key itself."),
    "corruption": RowColumn(_TEXT, "Name of the corruption, or `clean`."),
    "severity": RowColumn(_COUNT, "1 to 5; 0 in the clean row."),
    "truth": RowColumn(
        _TEXT, "What the corruption leaves of the ground truth: `unchanged`, or `none` if it moves content."
    ),
    "frames_digest": RowColumn(
        _TEXT, "Hash (BLAKE3, 16 bytes, hexadecimal) of the two frames that the model was given."
    ),
    "truth_digest": RowColumn(
        _TEXT, "Hash (BLAKE3, 16 bytes, hexadecimal) of the ground truth: its mask and its vectors."
    ),
    "height": RowColumn(_COUNT, "Height of the frames, pixels."),
    "width": RowColumn(_COUNT, "Width of the frames, pixels."),
    "n_invalid": RowColumn(_COUNT, "Pixels at which this row's prediction is not finite."),
    "n_all": RowColumn(_COUNT, "Usable pixels."),
    "rcre_all_sum": RowColumn(_NUMBER, "Distance from the clean flow, summed over `n_all`, pixels.", "n_all"),
    "pred_magnitude_sum": RowColumn(_NUMBER, "Length of the predicted flow, summed over `n_all`, pixels.", "n_all"),
    "n_photometric": RowColumn(_COUNT, "Pixels whose target according to the flow is inside the frame."),
    "photometric_sum": RowColumn(
        _NUMBER,
        "Difference between clean frame 1 and warped clean frame 2 over `n_photometric`, grey levels.",
        "n_photometric",
    ),
    "photometric_still_sum": RowColumn(
        _NUMBER, "The same for zero flow, over the same pixels, grey levels.", "n_photometric"
    ),
    "n_truth": RowColumn(_COUNT, "Pixels with ground truth, predicted or not.", "n_valid"),
    "n_valid": RowColumn(_COUNT, "Usable pixels with ground truth."),
    "epe_sum": RowColumn(_NUMBER, "End-point error, summed over `n_valid`, pixels.", "n_valid"),
    "clean_epe_sum": RowColumn(
        _NUMBER, "Error of the clean prediction, summed over the same `n_valid` pixels, pixels.", "n_valid"
    ),
    "rcre_sum": RowColumn(_NUMBER, "Distance from the clean flow, summed over `n_valid`, pixels.", "n_valid"),
    "magnitude_sum": RowColumn(_NUMBER, "Length of the true flow, summed over `n_valid`, pixels.", "n_valid"),
    "fl_count": RowColumn(
        _COUNT, "Pixels of `n_valid` with an error above 3 px and above 5 % of the true length.", "n_valid"
    ),
    "px1_count": RowColumn(_COUNT, "Pixels of `n_valid` with an error above 1 px.", "n_valid"),
    "px3_count": RowColumn(_COUNT, "Pixels of `n_valid` with an error above 3 px.", "n_valid"),
    "px5_count": RowColumn(_COUNT, "Pixels of `n_valid` with an error above 5 px.", "n_valid"),
    "wauc_sum": RowColumn(
        _NUMBER, "Weighted area under the inlier curve, summed over `n_valid`; 1 for a perfect pixel.", "n_valid"
    ),
    **{
        f"attack_{name}": RowColumn(kind, f"Rows of attacks only: {meaning}", signed=name == "way_gone")
        for name, kind, meaning in (
            ("linf", _NUMBER, "largest change of a value in the 8-bit frames, grey levels."),
            ("rms", _NUMBER, "root mean square of the change of the 8-bit frames, grey levels."),
            ("capped_sum", _NUMBER, "error, capped at the frame's diagonal, summed over `n_valid`, pixels."),
            ("median", _NUMBER, "median error over `n_valid`, pixels."),
            ("way_gone", _NUMBER, "share of the way from the clean flow to the attack's target."),
            ("late_gain", _NUMBER, "gain of the last quarter of the evaluations, in units of the loss."),
            ("start_spread", _NUMBER, "lead of the best start over the worst one, in units of the loss."),
            ("evaluations", _COUNT, "number of flows that the attack and its checks requested from the model."),
            ("gradient", _TEXT, "the gradient followed: `whole`, `as-written`, or what it was found to be instead."),
            ("warnings", _TEXT, "reasons why the row is doubtful, separated by commas."),
        )
    },
    **{
        f"{name}_{region}": RowColumn(kind, f"{meaning} in the region.", f"n_{region}" if name != "n" else "")
        for region in REGIONS
        for name, kind, meaning in (
            ("n", _COUNT, "Pixels of `n_valid`"),
            ("epe_sum", _NUMBER, "End-point error, summed over the pixels"),
            ("clean_epe_sum", _NUMBER, "Error of the clean prediction, summed over the pixels"),
            ("rcre_sum", _NUMBER, "Distance from the clean flow, summed over the pixels"),
            ("fl_count", _COUNT, "Pixels with an error above 3 px and above 5 % of the true length"),
        )
    },
    "ause": RowColumn(
        _NUMBER, "Runs with a confidence: area between its sparsification curve and the oracle's, pixels."
    ),
    "confidence_spearman": RowColumn(
        _NUMBER, "Runs with a confidence: rank correlation of confidence and error; -1 is best.", signed=True
    ),
    "rejected_count": RowColumn(
        _COUNT, "Runs with forward-backward confidence: pixels of `n_all` that the consistency check rejects."
    ),
    **{
        f"{curve}_at_{share}": RowColumn(_NUMBER, f"Runs with a confidence: mean error of the {share} % {of} pixels.")
        for curve, of in (("error", "most confident"), ("oracle", "best"))
        for share in COVERAGES
    },
    "spread_sum": RowColumn(
        _NUMBER, "Runs with several draws: standard deviation of the flow over them, summed over `n_all`, pixels."
    ),
}
"""The columns of the rows, in order. *Usable* pixels are those where both the prediction and the prediction on the
clean frames are finite. What needs ground truth is null without it, or if the corruption leaves none; what is measured
on request is null in other runs; the photometric sums are over the *clean* frames, also for the flow on corrupted ones.
"""

SIGNED = tuple(name for name, column in COLUMNS.items() if column.signed)
"""Columns that may be negative."""

ROW_SCHEMA: dict[str, type[pl.DataType]] = {name: column.kind for name, column in COLUMNS.items()}
"""Columns of the rows and their types, in order. Sums are in pixels, except `wauc_sum` (1 per pixel without error) and
the photometric sums (grey levels).
"""


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
            sample.key,
            f"the frames are {sample.shape[0]}x{sample.shape[1]}: the prediction (shape {pred.shape}) and the regions "
            "must have that size",
        )
    if (regions is None) != (sample.flow is None):
        raise DataError(sample.key, "the regions belong to a different sample; pass Regions.of(sample)")
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
    if regions is not None:
        row |= {"truth_digest": regions.truth_digest, "n_truth": int(np.count_nonzero(regions.valid))}
    return row | row_sums(pred, clean_pred, sample.flow, regions)


def rows_frame(rows: Iterable[dict[str, Any]]) -> pl.DataFrame:
    """Convert rows to a polars DataFrame with the columns and types of `ROW_SCHEMA`.

    >>> rows_frame([]).height
    0
    """
    return pl.DataFrame(list(rows), schema=ROW_SCHEMA, strict=True, orient="row")


_COUNTS = ("n_invalid", "n_all", "n_valid", "fl_count", "px1_count", "px3_count", "px5_count")
_ERRORS = ("epe", "rcre", "clean_epe")
_TOTALS = ("rcre_all_sum", "pred_magnitude_sum", "epe_sum", "rcre_sum", "magnitude_sum", "clean_epe_sum")


def row_sums(pred: Flow, clean: Flow, truth: Flow | None, regions: Regions | None) -> dict[str, int | float]:
    """Compute the counts and sums of one row by column; the sum over a region adds those of its labels."""
    a, b = flow_pair(pred, clean)
    if truth is None or regions is None:
        labels = np.full(a.shape[:2], OUTSIDE, np.uint8)
        arrays = (*dense(a, b, labels), np.empty((0, 0, 2), np.float32), np.empty((0, 0)))  # never read
    else:
        arrays = dense(a, b, regions.labels, flow_array(truth), regions.magnitude)
    counts, totals = np.empty(len(_COUNTS) + 1, np.int64), np.empty(len(_TOTALS))
    label_counts, label_totals = np.zeros((2, LABELS), np.int64), np.zeros((3, LABELS))
    pixels = [array.reshape(-1, *array.shape[2:]) for array in arrays]
    _sums(*pixels, counts, totals, label_counts, label_totals)
    counts[2:4] = label_counts.sum(axis=1)
    *counted, points = counts.tolist()
    sums: dict[str, int | float] = dict(zip((*_COUNTS, *_TOTALS), (*counted, *totals.tolist()), strict=True))
    if regions is None:
        return {name: sums[name] for name in _WITHOUT_TRUTH}
    sums["wauc_sum"] = points / WAUC_UNIT
    for name in regions.names:
        members = MEMBERS[name]
        for column, number in zip(("n", "fl_count"), label_counts[:, members].sum(axis=1).tolist(), strict=True):
            sums[f"{column}_{name}"] = number
        for column, parts in zip(_ERRORS, label_totals[:, members].tolist(), strict=True):
            sums[f"{column}_sum_{name}"] = math.fsum(parts)
    return sums


_VECTORS = "Array(float32, 2, 'C', readonly=True)"


@njit_late(
    f"void({_VECTORS}, {_VECTORS}, Array(uint8, 1, 'C', readonly=True), {_VECTORS}, "
    "Array(float64, 1, 'C', readonly=True), int64[::1], float64[::1], int64[:, ::1], float64[:, ::1])",
    cache=True,
)
def _sums(
    pred: Any,
    clean: Any,
    labels: Any,
    truth: Any,
    magnitude: Any,
    counts: Any,
    totals: Any,
    label_counts: Any,
    label_totals: Any,
) -> None:
    """Add up all sums and counts of a row in one pass over the pixels, by label; `pred` and `clean` are (H W, 2)."""
    n_invalid, n_all, px1, px3, px5, points = 0, 0, 0, 0, 0, 0
    moved_all, length_all, errors, moved_valid, magnitudes, before_all = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(labels.size):
        u, v = np.float64(pred[i, 0]), np.float64(pred[i, 1])
        length_square = u * u + v * v
        if not math.isfinite(length_square):
            n_invalid += 1
        clean_u, clean_v = np.float64(clean[i, 0]), np.float64(clean[i, 1])
        du, dv = u - clean_u, v - clean_v
        moved_square = du * du + dv * dv
        if not math.isfinite(moved_square):
            continue
        moved = math.sqrt(moved_square)
        n_all += 1
        moved_all += moved
        length_all += math.sqrt(length_square)
        label = labels[i]
        if label == OUTSIDE:
            continue
        true_u, true_v = np.float64(truth[i, 0]), np.float64(truth[i, 1])
        du, dv = u - true_u, v - true_v
        error = math.sqrt(du * du + dv * dv)
        du, dv = clean_u - true_u, clean_v - true_v
        before = math.sqrt(du * du + dv * dv)
        outlier = is_fl_outlier(error, magnitude[i])
        px1 += error > 1.0
        px3 += error > 3.0
        px5 += error > 5.0
        points += wauc_points(error)
        errors += error
        moved_valid += moved
        magnitudes += magnitude[i]
        before_all += before
        label_counts[0, label] += 1
        label_counts[1, label] += outlier
        label_totals[0, label] += error
        label_totals[1, label] += moved
        label_totals[2, label] += before
    counts[0], counts[1], counts[4], counts[5], counts[6], counts[7] = n_invalid, n_all, px1, px3, px5, points
    totals[0], totals[1], totals[2] = moved_all, length_all, errors
    totals[3], totals[4], totals[5] = moved_valid, magnitudes, before_all
