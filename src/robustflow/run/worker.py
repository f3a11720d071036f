"""Compute one unit in all stages: corrupt, predict, measure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from ..core.processes import one_opencv_thread
from ..core.types import Flow, Frame, Sample
from ..data.datasets.base import Dataset
from ..metrics.rows import CLEAN
from ..models.base import AnyModel
from ..models.confidence import Answer, flow_of
from .attack_stage import AttackStage, attack_columns
from .cells import Cell
from .frame_stage import FrameStage, Loaded
from .measure_stage import MeasureStage
from .plan import RunOptions, Unit
from .predict_stage import PredictStage
from .seconds import no_seconds


@dataclass(frozen=True)
class View:
    """One computed cell: the frames, the predicted flow and the measured row."""

    sample: Sample
    frames: tuple[Frame, ...]
    flow: Flow
    clean_flow: Flow
    row: dict[str, Any]


class Worker:
    """Compute units of one run, keeping the latest sample and its clean flow in memory."""

    def __init__(
        self,
        dataset: Dataset,
        model: AnyModel,
        options: RunOptions,
        clean_path: Callable[[str], Path] | None,
        on_predict: Callable[[str | None], None] = lambda what: None,
        batch_size: int = 1,
        kept: Mapping[str, dict[str, Any]] | None = None,
    ) -> None:
        self.seconds = no_seconds()
        self._frames = FrameStage(dataset, options, self.seconds)
        self._model = PredictStage(model, options.measuring.confidence, self.seconds, on_predict)
        self._attacks = AttackStage(model, options, self.seconds, on_predict)
        self._measure = MeasureStage(options, clean_path, kept or {}, self.seconds)
        self._batch_size = batch_size
        self.batches_attacks = batch_size > 1 and getattr(model, "batched_gradients", False) is True
        self._last: tuple[Loaded, Answer] | None = None

    def run(self, unit: Unit) -> list[dict[str, Any]]:
        """Return the rows of a unit, in the order of its severities."""
        loaded, clean = self._load(unit.key)
        if unit.corruption == CLEAN:
            return [self._row(loaded, clean, clean, loaded.sample.frames, (unit.key, CLEAN, 0))]
        if unit.corruption in self._attacks.names:
            return self.run_attack([unit])[0]
        rows = []
        for start in range(0, len(unit.cells), self._batch_size):
            cells = unit.cells[start : start + self._batch_size]
            corrupted = [self._frames.corrupt(loaded.sample, name, severity) for _, name, severity in cells]
            requests = [
                self._frames.request(loaded.sample, cell, frames) for cell, frames in zip(cells, corrupted, strict=True)
            ]
            flows = self._model.predict(requests)
            for flow, frames, cell in zip(flows, corrupted, cells, strict=True):
                rows.append(self._row(loaded, clean, flow, frames, cell))
        return rows

    def run_attack(self, units: Sequence[Unit]) -> list[list[dict[str, Any]]]:
        """Return the rows of the units of one attack; cells of different samples can share a batch."""
        targets = [(*self._load(unit.key), cell) for unit in units for cell in unit.cells]
        starts = range(0, len(targets), self._batch_size)
        rows = chain.from_iterable(self._attacked(targets[start : start + self._batch_size]) for start in starts)
        return [list(islice(rows, len(unit.cells))) for unit in units]

    def inspect_cell(self, key: str, corruption: str, severity: int) -> View:
        """Compute one cell and return its frames, flows and row."""
        loaded, clean = self._load(key)
        cell, frames = (key, corruption, severity), self._frames.corrupt(loaded.sample, corruption, severity)
        (flow,) = self._model.predict([self._frames.request(loaded.sample, cell, frames)])
        row = self._row(loaded, clean, flow, frames, cell)
        return View(loaded.under(row["truth"]).sample, frames, flow_of(flow), flow_of(clean), row)

    def sample(self, key: str) -> Sample:
        """Return a sample with its clean frames."""
        return self._load(key)[0].sample

    def clean_flow(self, key: str) -> Flow:
        """Return the flow between a sample's clean frames, float32 (H, W, 2), in pixels."""
        return flow_of(self._load(key)[1])

    def frames(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """Return the corrupted frames of a cell."""
        return self._frames.corrupt(self._load(key)[0].sample, corruption, severity)

    def _load(self, key: str) -> tuple[Loaded, Answer]:
        if self._last is None or self._last[0].sample.key != key:
            self._last = None  # release the previous sample before the next one is read
            loaded = self._frames.load(key)
            clean = self._measure.stored_clean(loaded)
            if clean is None:
                sample = loaded.sample
                (clean,) = self._model.predict([self._frames.request(sample, (key, CLEAN, 0), sample.frames)])
                self._measure.keep_clean(loaded, clean)
            self._last = (loaded, clean)
        return self._last

    def _attacked(self, targets: Sequence[tuple[Loaded, Answer, Cell]]) -> list[dict[str, Any]]:
        attacked = self._attacks.attack([(loaded.sample, flow_of(clean), cell) for loaded, clean, cell in targets])
        return [
            self._row(loaded, clean, one.flow, one.frames, cell) | attack_columns(one, loaded.sample)
            for one, (loaded, clean, cell) in zip(attacked, targets, strict=True)
        ]

    def _row(
        self, loaded: Loaded, clean: Answer, flow: Answer, frames: tuple[Frame, ...], cell: Cell
    ) -> dict[str, Any]:
        return self._measure.row(loaded, clean, flow, self._measure.digest(frames), cell)


@contextmanager
def temporary_worker(dataset: Dataset, model: AnyModel, options: RunOptions) -> Iterator[Worker]:
    """Create a worker for a few cells, which writes no files. OpenCV runs in one thread, as in every engine."""
    with one_opencv_thread():
        yield Worker(dataset, model, options, None)


class NoMotion:
    """A placeholder for a model whose prediction is not needed: the flow is zero everywhere."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Return zero flow, float32 (H, W, 2)."""
        return np.zeros((*frame1.shape[:2], 2), np.float32)
