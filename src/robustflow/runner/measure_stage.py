"""The last stage of a cell: measure a flow against the clean one and the ground truth; one row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ModelError
from ..metrics.error_maps import error_sum
from ..metrics.rows import CLEAN, measure
from ..models.base import describe_cell
from ..models.confidence import Answer, flow_of
from ..runs.clean_flows import read_clean, write_clean
from ..runs.plan import Cell, RunOptions
from ..sample import Flow, Mask
from .clean_row_check import check_same_data, check_same_model
from .confidence_columns import confidence_columns
from .frame_stage import Loaded
from .frames_digest import frames_digest
from .seconds import Seconds, timed


class MeasureStage:
    """Makes rows, and stores clean flows for the rest of their samples.

    Args:
        options: of the run.
        clean_path: where a sample's clean flow is stored between units, so that it is computed once per sample.
        kept: clean rows measured earlier, by sample (see `clean_row_check`).
        seconds: where "measure" is counted.
    """

    def __init__(
        self,
        options: RunOptions,
        clean_path: Callable[[str], Path],
        kept: Mapping[str, dict[str, Any]],
        seconds: Seconds,
    ) -> None:
        self._allow_invalid = options.allow_invalid
        self._draws = options.draws
        self._clean_path = clean_path
        self._kept = kept
        self._seconds = seconds

    def stored_clean(self, loaded: Loaded) -> Answer | None:
        """The clean flow that another unit of the sample stored; None if it has to be predicted.

        Raises:
            RunError: see `keep_clean`.
        """
        clean = read_clean(self._clean_path(loaded.sample.key), loaded.clean_flow_key)
        if clean is not None:
            self._check(loaded, clean)
        return clean

    def keep_clean(self, loaded: Loaded, clean: Answer) -> None:
        """Store a newly predicted clean flow.

        Raises:
            RunError: the run has a clean row of the sample that was measured with other frames, another ground truth or
                another model.
        """
        write_clean(self._clean_path(loaded.sample.key), clean, loaded.clean_flow_key)
        self._check(loaded, clean)

    def row(self, loaded: Loaded, clean: Answer, answer: Answer, digest: str, cell: Cell) -> dict[str, Any]:
        """Measure one row.

        Args:
            loaded: the sample.
            clean, answer: the model's, on the clean frames and on those of the cell; see `models.confidence`.
            digest: `digest` of the frames of the cell.
            cell: (sample key, corruption, severity).

        Raises:
            ModelError: a flow with pixels that are not finite, unless the run allows them.
        """
        _, corruption, severity = cell
        with timed(self._seconds, "measure"):
            flow, clean_flow = flow_of(answer), flow_of(clean)
            row = measure(
                flow,
                clean_flow,
                loaded.sample,
                loaded.regions,
                corruption=corruption,
                severity=severity,
                frames_digest=digest,
            )
            if self._draws > 1:
                row |= _spread(answer, clean_flow, cell)
            else:
                row |= confidence_columns(answer, clean_flow, loaded.sample)
        if row["n_invalid"] and not self._allow_invalid:
            raise ModelError(
                f"the model returned {row['n_invalid']} pixels that are NaN or infinite on {describe_cell(*cell)}; fix "
                "the model, or give --allow-invalid to exclude and count such pixels"
            )
        return row

    def digest(self, frames: tuple[Any, ...]) -> str:
        """The digest of a cell's pair."""
        with timed(self._seconds, "measure"):
            return frames_digest(frames[:2])

    def _check(self, loaded: Loaded, clean: Answer) -> None:
        before = self._kept.get(loaded.sample.key)
        if before is not None:
            digest = self.digest(loaded.sample.frames)
            now = self.row(loaded, clean, clean, digest, (loaded.sample.key, CLEAN, 0))
            check_same_data(before, now)
            check_same_model(before, now)


def _spread(answer: Answer, clean_flow: Flow, cell: Cell) -> dict[str, Any]:
    """The column of the spread over the draws; none for an attack, which has one."""
    if answer.shape[2] == 2:
        return {}
    usable: Mask = np.logical_and(np.isfinite(answer[..., :2]).all(axis=2), np.isfinite(clean_flow).all(axis=2))
    spread = answer[..., 2].astype(np.float64)
    if not np.isfinite(spread[usable]).all():
        raise ModelError(
            f"the model returned pixels that are NaN or infinite on {describe_cell(*cell)}, in a further draw; fix the "
            "model, or leave out --seeds"
        )
    return {"spread_sum": error_sum(spread, usable).total}
