"""Validation during training: evaluate the current network with `robustflow.evaluate`."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from ..core.errors import ModelError, UsageError
from ..core.text import counted
from ..core.types import Flow, Frame
from ..metrics.rows import CLEAN
from ..models.base import FlowModel, model_identity
from ..run.comparable import measured_cells, sample_set_of
from ..run.compute_missing import compute_missing
from ..run.engines.processes import SERIAL
from ..run.progress import Silent
from ..run.run import Run
from ..run.setup import open_benchmark, set_up
from ..run.store import RunFolder
from .request import Validation


@dataclass(frozen=True)
class _AtUpdate:
    """The model with its current weights; implements `FlowModel`."""

    model: FlowModel
    updates: int

    def identity(self) -> dict[str, Any]:
        return {**model_identity(self.model), "checkpoint": f"after {self.updates} updates"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        flow = self.model.predict(frame1, frame2)
        if not np.isfinite(flow).all():
            raise ModelError(
                "--validate",
                f"after {counted(self.updates, 'update')}, the network returns NaN or infinity in the validation; "
                "the last checkpoint is kept: try a lower --learning-rate, or check the network in evaluation mode",
            )
        return flow


class ValidationScores(NamedTuple):
    """The result of a validation."""

    numbers: dict[str, float]
    pairs: str


def validator(model: FlowModel, folder: Path, validation: Validation) -> Callable[[int], ValidationScores]:
    """Return a function that takes the number of updates and measures the model on a benchmark."""
    corruptions, limit = validation.corruptions, validation.limit
    chosen = open_benchmark(validation.benchmark, validation.data)
    chosen = chosen.narrowed(corruptions or None, None, limit)
    if not corruptions:
        chosen = replace(chosen, corruptions=(), severities=())
    if not chosen.dataset.has_flow:
        raise UsageError(
            "--validate",
            f"{validation.benchmark}: this benchmark has no ground truth, so no error can be measured; "
            "choose a different one",
        )

    def validate(updates: int) -> ValidationScores:
        place = folder / "validation" / f"update-{updates}"
        if place.exists():
            shutil.rmtree(place)
        store = RunFolder(place)
        store.lock()
        try:
            compute_missing(store, set_up(_AtUpdate(model, updates), chosen), SERIAL, Silent())
        finally:
            store.unlock()
        run = Run(place)
        run.write_means()
        assert run.epe_clean is not None
        numbers = {"epe": run.epe_clean}
        if corruptions:
            numbers |= {name: value for name, value in (("cre", run.cre), ("rcre", run.rcre)) if value is not None}
        clean = run.rows.filter(pl.col("corruption") == CLEAN)
        return ValidationScores(numbers, sample_set_of(run.manifest.identity.frames.record(), measured_cells(clean)))

    return validate
