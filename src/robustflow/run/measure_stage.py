"""The last stage of a cell: compare its flow with the clean flow and the ground truth, and return one row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ModelError
from ..core.types import Flow, Mask, Sample
from ..corruptions.stack import truth_under
from ..metrics.confidence import STEPS, confidence_correlation, forward_backward, sparsification
from ..metrics.error_maps import epe_map, error_sum
from ..metrics.rows import CLEAN, COVERAGES, measure
from ..models.base import describe_cell
from ..models.confidence import Answer, flow_of
from .cells import Cell
from .frame_stage import Loaded, frames_digest, memory_errors_named
from .plan import RunOptions
from .seconds import Seconds, timed
from .trust import check_same, read_array, write_array


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


class MeasureStage:
    """Compute rows, and store clean flows for the remaining cells of their samples."""

    def __init__(
        self,
        options: RunOptions,
        clean_path: Callable[[str], Path] | None,
        kept: Mapping[str, dict[str, Any]],
        seconds: Seconds,
    ) -> None:
        self._truths = dict.fromkeys((CLEAN, *options.attacks), "unchanged")
        self._allow_invalid = options.measuring.allow_invalid
        self._draws = options.measuring.draws
        self._clean_path = clean_path
        self._kept = kept
        self._seconds = seconds

    def stored_clean(self, loaded: Loaded) -> Answer | None:
        """Return the clean flow stored by an earlier unit of the sample; None if it has to be predicted."""
        if self._clean_path is None:
            return None
        clean = read_array(self._clean_path(loaded.sample.key), loaded.clean_flow_key)
        if clean is not None:
            self._check(loaded, clean)
        return clean

    def keep_clean(self, loaded: Loaded, clean: Answer) -> None:
        """Store a newly predicted clean flow."""
        if self._clean_path is not None:
            write_array(self._clean_path(loaded.sample.key), clean, loaded.clean_flow_key)
        self._check(loaded, clean)

    def row(self, loaded: Loaded, clean: Answer, answer: Answer, digest: str, cell: Cell) -> dict[str, Any]:
        """Measure one row."""
        _, corruption, severity = cell
        truth = self.truth(corruption)
        loaded = loaded.under(truth)
        with memory_errors_named(describe_cell(*cell)), timed(self._seconds, "measure"):
            flow, clean_flow = flow_of(answer), flow_of(clean)
            row = measure(
                flow,
                clean_flow,
                loaded.sample,
                loaded.regions,
                corruption=corruption,
                severity=severity,
                truth=truth,
                frames_digest=digest,
            )
            if self._draws > 1:
                row |= _spread(answer, clean_flow, cell)
            else:
                row |= confidence_columns(answer, clean_flow, loaded.sample)
        if row["n_invalid"] and not self._allow_invalid:
            raise ModelError(
                f"the model returned {row['n_invalid']} pixels that are NaN or infinite on {describe_cell(*cell)}; fix "
                "the model, or use --allow-invalid to exclude and count such pixels"
            )
        return row

    def truth(self, name: str) -> str:
        """Return what a corruption or an attack leaves of the ground truth (`Corruption.truth`)."""
        if name not in self._truths:
            self._truths[name] = truth_under(name)
        return self._truths[name]

    def digest(self, frames: tuple[Any, ...]) -> str:
        """Return the digest of a cell's pair."""
        with timed(self._seconds, "measure"):
            return frames_digest(frames[:2])

    def _check(self, loaded: Loaded, clean: Answer) -> None:
        before = self._kept.get(loaded.sample.key)
        if before is not None:
            digest = self.digest(loaded.sample.frames)
            now = self.row(loaded, clean, clean, digest, (loaded.sample.key, CLEAN, 0))
            check_same(before, now)


def _spread(answer: Answer, clean_flow: Flow, cell: Cell) -> dict[str, Any]:
    """Return the column with the spread over the draws; empty for an attack, which has one draw."""
    if answer.shape[2] == 2:
        return {}
    usable: Mask = np.logical_and(np.isfinite(answer[..., :2]).all(axis=2), np.isfinite(clean_flow).all(axis=2))
    spread = answer[..., 2].astype(np.float64)
    if not np.isfinite(spread[usable]).all():
        raise ModelError(
            f"the model returned pixels that are NaN or infinite on {describe_cell(*cell)}, in an additional draw; fix "
            "the model, or omit --seeds"
        )
    return {"spread_sum": error_sum(spread, usable).total}
