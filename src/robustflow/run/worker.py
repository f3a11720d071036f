"""Compute units with a model of this process, and single cells for pictures and checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from queue import SimpleQueue
from typing import Any

from ..core.compiled import load_numba
from ..core.opencv import one_opencv_thread
from ..core.types import Flow, Frame, Sample
from ..models.confidence import flow_of
from .computation import Computation, FinishedUnit, Ready, Task, compute_units
from .manifest import Cell
from .plan import Job, Unit
from .stages import OpenSample, PredictionRequest, PredictStage, Seconds

UNITS_AHEAD = 3
"""Number of further units that a model's next frames can come from."""


@dataclass(frozen=True)
class View:
    """One computed cell: the frames, the predicted flow and the measured row."""

    sample: Sample
    frames: tuple[Frame, ...]
    flow: Flow
    clean_flow: Flow
    row: dict[str, Any]


class _OtherThread:
    """Let another thread predict flows: the one that iterates over the finished units."""

    def __init__(self, units: Iterable[Unit]) -> None:
        self._units = iter(units)
        self._free = 1 + UNITS_AHEAD
        self.outbox = SimpleQueue[tuple[Task, list[PredictionRequest]] | FinishedUnit | None]()
        self.inbox = SimpleQueue[Ready | None]()
        """Tasks whose flows have been predicted; None to end the loop."""

    def compute(self, computation: Computation) -> None:
        """Run the loop in this thread."""
        try:
            for done in compute_units(computation, self._receive, lambda *request: self.outbox.put(request)):
                self._free += 1
                self.outbox.put(done)
        finally:
            self.outbox.put(None)

    def _receive(self, task: Task | None) -> Iterable[Unit | Ready]:
        if units := list(islice(self._units, self._free)):
            self._free -= len(units)
            return units
        if task is not None:  # before flows that have arrived: the order of predictions does not depend on their speed
            return [Ready(task)]
        ready = self.inbox.get() if self._free <= UNITS_AHEAD else None
        return [] if ready is None else [ready]


class Worker:
    """Compute units of one run, keeping the latest sample and its clean flow in memory."""

    def __init__(self, job: Job, on_predict: Callable[[str | None], None] = lambda what: None) -> None:
        model = job.model.load()
        self._seconds = Seconds(float)
        self._computation = Computation(job, self._seconds)
        self._model = PredictStage(model, job.measuring.confidence, on_predict)
        self._attacks = None
        if job.attacks:
            from .attack_stage import AttackStage

            self._attacks = AttackStage(model, job, self._seconds, on_predict)
        self._batch_size = job.batch_size
        self.batches_attacks = job.batch_size > 1 and getattr(model, "batched_gradients", False) is True

    def run(self, unit: Unit) -> FinishedUnit:
        """Compute a unit; its rows are in the order of its severities."""
        if self._attacks is not None and unit.corruption in self._attacks.attacks:
            return self.run_attack([unit])[0]
        arrived: list[Unit | Ready] = [unit]

        def receive(task: Task | None) -> list[Unit | Ready]:
            messages = arrived.copy() or ([Ready(task)] if task else [])
            arrived.clear()
            return messages

        def predict(task: Task, requests: list[PredictionRequest]) -> None:
            arrived.append(Ready(task, *self._model.predict(requests)))

        (done,) = compute_units(self._computation, receive, predict)
        return done

    def run_ahead(self, units: Iterable[Unit]) -> Iterator[FinishedUnit]:
        """Compute units that are no attacks. The model works in this thread, while a second one measures its flows and
        prepares the next frames."""
        load_numba()
        place = _OtherThread(units)
        with ThreadPoolExecutor(1) as thread:
            loop = thread.submit(place.compute, self._computation)
            try:
                while (message := place.outbox.get()) is not None:
                    if isinstance(message, FinishedUnit):
                        yield message
                    else:
                        place.inbox.put(self._predicted(*message))
                loop.result()
            finally:
                place.inbox.put(None)

    def _predicted(self, task: Task, requests: list[PredictionRequest]) -> Ready:
        try:
            return Ready(task, *self._model.predict(requests))
        except Exception as error:
            return Ready(task, error)

    def run_attack(self, units: Sequence[Unit]) -> list[FinishedUnit]:
        """Compute the units of one attack; cells of different samples can share a batch."""
        targets = [(self._open(unit.key), cell) for unit in units for cell in unit.cells]
        starts = range(0, len(targets), self._batch_size)
        rows = chain.from_iterable(self._attacked(targets[start : start + self._batch_size]) for start in starts)
        of_units = [list(islice(rows, len(unit.cells))) for unit in units]
        return [self._computation.finished(*finished) for finished in zip(units, of_units, strict=True)]

    def _attacked(self, targets: Sequence[tuple[OpenSample, Cell]]) -> list[dict[str, Any]]:
        assert self._attacks is not None
        attacked = self._attacks.attack([(opened.sample, opened.clean_flow, cell) for opened, cell in targets])
        return [
            self._computation.row(opened, pair.flow, self._computation.digest(pair.frames), cell)
            | self._attacks.columns(pair, opened.sample)
            for pair, (opened, cell) in zip(attacked, targets, strict=True)
        ]

    def inspect_cell(self, key: str, corruption: str, severity: int) -> View:
        """Compute one cell and return its frames, flows and row."""
        opened = self._open(key)
        cell, frames = (key, corruption, severity), self.frames(key, corruption, severity)
        ((answer,), _) = self._model.predict([self._computation.frames.request(opened.sample, cell, frames)])
        row = self._computation.row(opened, answer, self._computation.digest(frames), cell)
        sample = opened.sample if row["truth"] == "unchanged" else opened.sample.without_truth()
        return View(sample, frames, flow_of(answer), opened.clean_flow, row)

    def sample(self, key: str) -> Sample:
        return self._open(key).sample

    def clean_flow(self, key: str) -> Flow:
        return self._open(key).clean_flow

    def frames(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        return self._computation.frames.corrupt(self.sample(key), corruption, severity)

    def _open(self, key: str) -> OpenSample:
        """Return a sample whose clean flow is known."""
        self._computation.release([key])
        opened = self._computation.open(key)
        if opened.clean is None:
            ((clean,), seconds) = self._model.predict([self._computation.request_clean(opened.sample)])
            self._computation.predicted(seconds)
            self._computation.set_clean(opened, clean)
        return opened


@contextmanager
def temporary_worker(job: Job) -> Iterator[Worker]:
    """Create a worker for a few cells. OpenCV runs in one thread, as in every engine."""
    with one_opencv_thread():
        yield Worker(job)
