"""Compute all sums of a row in one pass over the pixels.

Each sum adds its pixels sequentially in row-major order, in float64, so on every machine it is bit-identical to the
result of a separate pass. `rows` documents which pixels contribute to each sum.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit_late, types
from ..core.types import Flow
from .error_maps import ERRORS_TYPE, FLOW_TYPE, WAUC_UNIT, dense, flow_array, flow_pair, is_fl_outlier, wauc_points
from .regions import LABELS, LABELS_TYPE, MEMBERS, OUTSIDE, Regions

_COUNTS = ("n_invalid", "n_all", "n_valid", "fl_count", "px1_count", "px3_count", "px5_count")
_ERRORS = ("epe", "rcre", "clean_epe")
_TOTALS = ("rcre_all_sum", "pred_magnitude_sum", "epe_sum", "rcre_sum", "magnitude_sum", "clean_epe_sum")


class RowSums(NamedTuple):
    """Sums over all pixels and over the pixels of each label."""

    whole: dict[str, int | float]
    label_counts: npt.NDArray[np.int64]
    label_totals: npt.NDArray[np.float64]

    def region(self, name: str) -> dict[str, int | float]:
        """Return the sums of a region, keyed by column name without the region name."""
        labels = MEMBERS[name]
        counts, totals = self.label_counts[:, labels], self.label_totals[:, labels]
        sums: dict[str, int | float] = dict(zip(("n", "fl_count"), counts.sum(axis=1).tolist(), strict=True))
        return sums | {f"{column}_sum": math.fsum(row) for column, row in zip(_ERRORS, totals, strict=True)}


def row_sums(pred: Flow, clean: Flow, truth: Flow | None, regions: Regions | None) -> RowSums:
    """Compute the sums of one row."""
    a, b = flow_pair(pred, clean)
    if truth is None or regions is None:
        labels = np.full(a.shape[:2], OUTSIDE, np.uint8)
        arrays = (*dense(a, b, labels), np.empty((0, 0, 2), np.float32), np.empty((0, 0)))  # never read
    else:
        arrays = dense(a, b, regions.labels, flow_array(truth), regions.magnitude)
    counts, totals = np.empty(len(_COUNTS) + 1, np.int64), np.empty(len(_TOTALS))
    label_counts, label_totals = np.zeros((2, LABELS), np.int64), np.zeros((3, LABELS))
    _sums(*arrays, counts, totals, label_counts, label_totals)
    *counted, points = counts.tolist()
    whole: dict[str, int | float] = dict(zip(_COUNTS, counted, strict=True))
    whole |= zip(_TOTALS, totals.tolist(), strict=True)
    whole["wauc_sum"] = points / WAUC_UNIT
    return RowSums(whole, label_counts, label_totals)


@njit_late(
    types.void(
        *(FLOW_TYPE, FLOW_TYPE, LABELS_TYPE, FLOW_TYPE, ERRORS_TYPE),
        *(types.int64[::1], types.float64[::1], types.int64[:, ::1], types.float64[:, ::1]),
    ),
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
    n_invalid, n_all, n_valid, fl, px1, px3, px5, points = 0, 0, 0, 0, 0, 0, 0, 0
    moved_all, length_all, errors, moved_valid, magnitudes, before_all = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            u, v = np.float64(pred[y, x, 0]), np.float64(pred[y, x, 1])
            length_square = u * u + v * v
            if not math.isfinite(length_square):
                n_invalid += 1
            clean_u, clean_v = np.float64(clean[y, x, 0]), np.float64(clean[y, x, 1])
            du, dv = u - clean_u, v - clean_v
            moved_square = du * du + dv * dv
            if not math.isfinite(moved_square):
                continue
            moved = math.sqrt(moved_square)
            n_all += 1
            moved_all += moved
            length_all += math.sqrt(length_square)
            label = labels[y, x]
            if label == OUTSIDE:
                continue
            true_u, true_v = np.float64(truth[y, x, 0]), np.float64(truth[y, x, 1])
            du, dv = u - true_u, v - true_v
            error = math.sqrt(du * du + dv * dv)
            du, dv = clean_u - true_u, clean_v - true_v
            before = math.sqrt(du * du + dv * dv)
            outlier = is_fl_outlier(error, magnitude[y, x])
            n_valid += 1
            fl += outlier
            px1 += error > 1.0
            px3 += error > 3.0
            px5 += error > 5.0
            points += wauc_points(error)
            errors += error
            moved_valid += moved
            magnitudes += magnitude[y, x]
            before_all += before
            label_counts[0, label] += 1
            label_counts[1, label] += outlier
            label_totals[0, label] += error
            label_totals[1, label] += moved
            label_totals[2, label] += before
    counts[0], counts[1], counts[2], counts[3] = n_invalid, n_all, n_valid, fl
    counts[4], counts[5], counts[6], counts[7] = px1, px3, px5, points
    totals[0], totals[1], totals[2] = moved_all, length_all, errors
    totals[3], totals[4], totals[5] = moved_valid, magnitudes, before_all
