"""Compute one unit in all stages: prepare frames, predict, measure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any, TypeVar, cast

import numpy as np

from ..core.compiled import load_numba
from ..core.errors import ModelError
from ..core.processes import one_opencv_thread
from ..core.text import counted
from ..core.types import Flow, Frame, Mask, Sample
from ..corruptions.stack import truth_under
from ..metrics.confidence import STEPS, confidence_correlation, forward_backward, sparsification
from ..metrics.error_maps import epe_map, error_sum
from ..metrics.photometric import Misread, misread, misread_truth
from ..metrics.rows import CLEAN, COVERAGES, measure
from ..models.base import describe_cell
from ..models.confidence import Answer, flow_of
from .cells import Cell
from .plan import Job, Unit
from .stages import (
    FrameStage,
    OpenSample,
    PredictionRequest,
    PredictStage,
    Seconds,
    frames_digest,
    memory_errors_named,
    timed,
)
from .store import RunFolder
from .trust import check_same, read_array, write_array

T = TypeVar("T")
_Rows = list[dict[str, Any]]


OF_MODEL, OF_TRUTH = "the model's flow", "the ground truth"


@dataclass(frozen=True)
class FinishedUnit:
    """A finished unit: its rows, and the seconds spent on each kind of work."""

    unit: Unit
    rows: list[dict[str, Any]]
    seconds: dict[str, float]
    misread: dict[str, Misread] = field(default_factory=dict)
    """Flows of the run's first sample that seem to have a wrong format: `OF_MODEL`, `OF_TRUTH`."""
    place: str | None = None
    """Node and device that computed the unit, if the engine has several."""


@dataclass(frozen=True)
class View:
    """One computed cell: the frames, the predicted flow and the measured row."""

    sample: Sample
    frames: tuple[Frame, ...]
    flow: Flow
    clean_flow: Flow
    row: dict[str, Any]


def misread_flows(sample: Sample, flow: Flow) -> dict[str, Misread]:
    """Return the wrong formats of a model's flow and of the ground truth of a sample."""
    judged = {OF_MODEL: misread([(sample.frames[0], sample.frames[1], flow)]), OF_TRUTH: misread_truth(sample)}
    return {whose: wrong for whose, wrong in judged.items() if wrong is not None}


def _invalid(what: str, cell: Cell, remedy: str) -> ModelError:
    return ModelError(describe_cell(*cell), f"the model returned {what} that are NaN or infinite; fix it, or {remedy}")


def _confidence_columns(answer: Answer, clean_flow: Flow, sample: Sample) -> dict[str, Any]:
    """Return the columns of the confidence of a flow; empty if it has none."""
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


def _spread_column(answer: Answer, clean_flow: Flow, cell: Cell) -> dict[str, Any]:
    """Return the spread over the draws; empty for an attack, which has one draw."""
    if answer.shape[2] == 2:
        return {}
    usable: Mask = np.logical_and(np.isfinite(answer[..., :2]).all(axis=2), np.isfinite(clean_flow).all(axis=2))
    spread = answer[..., 2].astype(np.float64)
    if not np.isfinite(spread[usable]).all():
        raise _invalid("pixels of an additional draw", cell, "omit --seeds")
    return {"spread_sum": error_sum(spread, usable)[1]}


Steps = Generator[list[PredictionRequest], Sequence[Answer], T]
"""A computation that yields requests and receives their answers. An empty list lets other computations continue."""


class Computation:
    """Compute rows in steps, so that an engine decides where and when their flows are predicted. The answers of a
    sample arrive in the order of their requests."""

    def __init__(self, job: Job, seconds: Seconds) -> None:
        self.frames = FrameStage(job, seconds)
        self._truths = dict.fromkeys((CLEAN, *job.attacks), "unchanged")
        """What a corruption or an attack leaves of the ground truth (`Corruption.truth`), by name."""
        self._options = job.measuring
        self._folder = None if job.folder is None else RunFolder(job.folder)
        self._kept, self._first = job.kept, job.first
        self._misread: dict[str, Misread] = {}
        self._batch_size = job.batch_size
        self._seconds = seconds
        self._samples: dict[str, OpenSample] = {}

    def release(self, needed: Container[str]) -> None:
        """Free the memory of all samples but those needed."""
        self._samples = {key: opened for key, opened in self._samples.items() if key in needed}

    def open(self, key: str) -> Steps[OpenSample]:
        """Return a sample whose clean flow is known, or has been requested by an earlier computation. The clean flow
        is stored for other workers, and its row must be the one that the run already has, if any."""
        if key not in self._samples:
            opened = self._samples[key] = self.frames.load(key)
            path = None if self._folder is None else self._folder.clean_path(key)
            opened.clean = None if path is None else read_array(path, key)
            cell = (key, CLEAN, 0)
            if opened.clean is None:
                (opened.clean,) = yield [self.frames.request(opened.sample, cell, opened.sample.frames)]
                if path is not None:
                    write_array(path, opened.clean, key)
            if key in self._kept:
                check_same(self._kept[key], self.row(opened, opened.clean, self.digest(opened.sample.frames), cell))
        return self._samples[key]

    def rows(self, unit: Unit) -> Steps[list[dict[str, Any]]]:
        """Return the rows of a unit that is no attack, in the order of its severities."""
        opened = yield from self.open(unit.key)
        if unit.corruption == CLEAN:
            assert opened.clean is not None
            if unit.key == self._first:
                self._misread = misread_flows(opened.sample, flow_of(opened.clean))
            return [self.row(opened, opened.clean, self.digest(opened.sample.frames), unit.cells[0])]
        rows = []
        for start in range(0, len(unit.cells), self._batch_size):
            yield []
            cells, digests = unit.cells[start : start + self._batch_size], list[str]()
            answers = yield [self._request(opened, cell, digests) for cell in cells]
            rows += [self.row(opened, *one) for one in zip(answers, digests, cells, strict=True)]
            del answers  # free the memory, which the frames of the next cells can use
        return rows

    def finished(self, unit: Unit, rows: list[dict[str, Any]]) -> FinishedUnit:
        """Return a unit with the seconds since the previous one was finished."""
        wrong, self._misread = self._misread, {}
        seconds = dict(self._seconds)
        self._seconds.clear()
        return FinishedUnit(unit, rows, seconds, wrong)

    def _request(self, opened: OpenSample, cell: Cell, digests: list[str]) -> PredictionRequest:
        """Return the request for a cell, and add the digest of its frames to a list."""
        frames = self.frames.corrupt(opened.sample, *cell[1:])
        digests.append(self.digest(frames))
        return self.frames.request(opened.sample, cell, frames)

    def digest(self, frames: tuple[Frame, ...]) -> str:
        with timed(self._seconds, "measure"):
            return frames_digest(frames[:2])

    def row(self, opened: OpenSample, answer: Answer, digest: str, cell: Cell) -> dict[str, Any]:
        """Measure the flow of a cell, whose frames have this digest."""
        assert opened.clean is not None
        _, corruption, severity = cell
        if corruption not in self._truths:
            self._truths[corruption] = truth_under(corruption)
        truth = self._truths[corruption]
        sample, regions = opened.sample, opened.regions
        if truth != "unchanged":
            sample, regions = sample.without_truth(), None
        with memory_errors_named(describe_cell(*cell)), timed(self._seconds, "measure"):
            flow, clean_flow = flow_of(answer), flow_of(opened.clean)
            row = measure(
                flow,
                clean_flow,
                sample,
                regions,
                corruption=corruption,
                severity=severity,
                truth=truth,
                frames_digest=digest,
            )
            if self._options.draws > 1:
                row |= _spread_column(answer, clean_flow, cell)
            else:
                row |= _confidence_columns(answer, clean_flow, sample)
        if row["n_invalid"] and not self._options.allow_invalid:
            raise _invalid(
                counted(row["n_invalid"], "pixel"), cell, "use --allow-invalid to exclude and count such pixels"
            )
        return row


UNITS_AHEAD = 3
"""Number of further units that a model's next frames can come from. One cell of each is prepared in turn, so that one
slow corruption does not keep the model waiting."""


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

    def run(self, unit: Unit) -> list[dict[str, Any]]:
        """Return the rows of a unit, in the order of its severities."""
        if self._attacks is not None and unit.corruption in self._attacks.names:
            return self.run_attack([unit])[0]
        self._computation.release([unit.key])
        return self._completed(self._computation.rows(unit))

    def finished(self, unit: Unit, rows: list[dict[str, Any]]) -> FinishedUnit:
        return self._computation.finished(unit, rows)

    def run_ahead(self, units: Iterable[Unit]) -> Iterator[FinishedUnit]:
        """Compute units that are no attacks. The model works in this thread, while a second one measures its flows and
        prepares the next frames. Before an error is raised, all units before it are finished."""
        load_numba()
        waiting, thread, error = enumerate(units), ThreadPoolExecutor(1), None
        running = deque[tuple[int, Unit, Steps[_Rows], Future[list[PredictionRequest] | FinishedUnit]]]()
        measuring = running.copy()
        """Units whose flows are all predicted."""
        try:
            while True:
                for number, unit in islice(waiting, 0 if error else 1 + UNITS_AHEAD - len(running)):
                    thread.submit(self._computation.release, {unit.key, *(other.key for _, other, *_ in running)})
                    steps = self._computation.rows(unit)
                    running.append((number, unit, steps, thread.submit(self._advance_unit, unit, steps)))
                measured = measuring and (not running or measuring[0][-1].done())
                if not measured and not running:
                    break
                number, unit, steps, advanced = (measuring if measured else running).popleft()
                try:
                    result = advanced.result()
                    if not isinstance(result, FinishedUnit):
                        advanced = thread.submit(self._advance_unit, unit, steps, *self._model.predict(result))
                        predicted = result[-1].cell == unit.cells[-1]
                        (measuring if predicted else running).append((number, unit, steps, advanced))
                except Exception as first_so_far:
                    error = first_so_far
                    running, measuring = (
                        deque(one for one in each if one[0] < number) for each in (running, measuring)
                    )
                else:
                    if isinstance(result, FinishedUnit):
                        yield result
            if error is not None:
                raise error
        finally:
            thread.shutdown(cancel_futures=True)

    def _advance_unit(
        self, unit: Unit, steps: Steps[_Rows], answers: list[Answer] | None = None, predicting: float = 0.0
    ) -> list[PredictionRequest] | FinishedUnit:
        requests, rows = self._advance(steps, answers, predicting)
        return requests if rows is None else self.finished(unit, rows)

    def run_attack(self, units: Sequence[Unit]) -> list[list[dict[str, Any]]]:
        """Return the rows of the units of one attack; cells of different samples can share a batch."""
        targets = [(*self._open(unit.key), cell) for unit in units for cell in unit.cells]
        starts = range(0, len(targets), self._batch_size)
        rows = chain.from_iterable(self._attacked(targets[start : start + self._batch_size]) for start in starts)
        return [list(islice(rows, len(unit.cells))) for unit in units]

    def inspect_cell(self, key: str, corruption: str, severity: int) -> View:
        """Compute one cell and return its frames, flows and row."""
        opened, clean = self._open(key)
        cell, frames = (key, corruption, severity), self.frames(key, corruption, severity)
        ((flow,), _) = self._model.predict([self._computation.frames.request(opened.sample, cell, frames)])
        row = self._computation.row(opened, flow, self._computation.digest(frames), cell)
        sample = opened.sample if row["truth"] == "unchanged" else opened.sample.without_truth()
        return View(sample, frames, flow_of(flow), flow_of(clean), row)

    def sample(self, key: str) -> Sample:
        return self._open(key)[0].sample

    def clean_flow(self, key: str) -> Flow:
        return flow_of(self._open(key)[1])

    def frames(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        return self._computation.frames.corrupt(self.sample(key), corruption, severity)

    def _open(self, key: str) -> tuple[OpenSample, Answer]:
        self._computation.release([key])
        opened = self._completed(self._computation.open(key))
        assert opened.clean is not None
        return opened, opened.clean

    def _completed(self, steps: Steps[T]) -> T:
        """Take all steps of a computation, with the flows of this process's model."""
        requests, result = self._advance(steps)
        while requests:
            requests, result = self._advance(steps, *self._model.predict(requests))
        return cast(T, result)

    def _advance(
        self, steps: Steps[T], answers: list[Answer] | None = None, predicting: float = 0.0
    ) -> tuple[list[PredictionRequest], T | None]:
        """Continue a computation up to its next requests, or to its result."""
        self._seconds["predict"] += predicting
        try:
            requests = next(steps) if answers is None else steps.send(answers)
            if answers:
                answers.clear()  # free the memory
            while not requests:
                requests = next(steps)
        except StopIteration as end:
            return [], end.value
        return requests, None

    def _attacked(self, targets: Sequence[tuple[OpenSample, Answer, Cell]]) -> list[dict[str, Any]]:
        assert self._attacks is not None
        attacked = self._attacks.attack([(opened.sample, flow_of(clean), cell) for opened, clean, cell in targets])
        return [
            self._computation.row(opened, one.flow, self._computation.digest(one.frames), cell)
            | self._attacks.columns(one, opened.sample)
            for one, (opened, _, cell) in zip(attacked, targets, strict=True)
        ]


@contextmanager
def temporary_worker(job: Job) -> Iterator[Worker]:
    """Create a worker for a few cells. OpenCV runs in one thread, as in every engine."""
    with one_opencv_thread():
        yield Worker(job)
