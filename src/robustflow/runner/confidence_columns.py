"""Compute the columns of a row that describe the confidence of its flow."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..metrics.confidence import STEPS, confidence_correlation, forward_backward, sparsification
from ..metrics.error_maps import epe_map
from ..metrics.rows import COVERAGES
from ..models.confidence import Answer, flow_of
from ..sample import Flow, Sample


def confidence_columns(answer: Answer, clean_flow: Flow, sample: Sample) -> dict[str, Any]:
    """Return the confidence columns of `robustflow.metrics.rows` for a flow; empty if the flow has no confidence."""
    if answer.shape[2] == 2:
        return {}
    flow = flow_of(answer)
    usable = np.isfinite(flow).all(axis=2) & np.isfinite(clean_flow).all(axis=2)
    columns: dict[str, Any] = {}
    if answer.shape[2] == 4:
        confidence, rejected = forward_backward(flow, np.ascontiguousarray(answer[..., 2:]))
        columns["rejected_count"] = int(np.count_nonzero(rejected & usable))
    else:
        confidence = answer[..., 2].astype(np.float64)
    if sample.flow is None or sample.valid is None:
        return columns
    measured = usable & sample.valid
    errors, confidence = epe_map(flow, sample.flow)[measured], confidence[measured]
    curves = sparsification(errors, confidence)
    if curves is None:
        return columns
    columns |= {"ause": curves.ause, "confidence_spearman": confidence_correlation(errors, confidence)}
    for share in COVERAGES:
        columns[f"error_at_{share}"] = float(curves.by_confidence[STEPS - share])
        columns[f"oracle_at_{share}"] = float(curves.by_error[STEPS - share])
    return columns
