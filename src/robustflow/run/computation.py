"""Compute the rows of units in steps, wherever their flows are predicted: prepare frames, wait for flows, measure.

`compute_units` is the one loop of all engines: it starts units, takes one step of one of them at a time, and finishes
them. An engine says where flows are predicted: in this thread, another thread, or another process.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import ModelError
from ..core.text import counted
from ..core.types import Flow, Frame, Mask, Sample
from ..metrics.confidence import STEPS, confidence_correlation, forward_backward, sparsification
from ..metrics.error_maps import epe_map, error_sum
from ..metrics.photometric import Misread, misread, misread_truth
from ..metrics.rows import CLEAN, COVERAGES, measure
from ..models.calls import describe_cell
from ..models.confidence import Answer, flow_of
from .manifest import Cell
from .plan import Job, Unit
from .stages import (
    FrameStage,
    OpenSample,
    PredictionRequest,
    Seconds,
    frames_digest,
    memory_errors_named,
    timed,
)
from .store import RunFolder
from .trust import check_same, read_array, write_array

OF_MODEL, OF_TRUTH = "the model's flow", "the ground truth"


@dataclass(frozen=True)
class FinishedUnit:
    """A finished unit: its rows, and the seconds spent on each kind of work."""

    unit: Unit
    rows: list[dict[str, Any]]
    seconds: dict[str, float]
    misread: dict[str, Misread] = field(default_factory=dict)
    """Flows of the run's first sample that seem to have a wrong format: `OF_MODEL`, `OF_TRUTH`."""
    differs: bool = False
    """Whether the model predicted another flow when it was asked twice for that of the run's first sample."""
    place: str | None = None
    """Node and device that computed the unit, if the engine has several."""


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


Rows = list[dict[str, Any]]
Steps = Generator[list[PredictionRequest], Sequence[Answer] | None, Rows]
"""A computation that yields requests and receives their answers. An empty list lets other computations continue."""


class Computation:
    """Compute the rows of units in steps, and keep the samples in progress in memory. The answers of a sample arrive in
    the order of their requests."""

    def __init__(self, job: Job, seconds: Seconds) -> None:
        self.frames = FrameStage(job, seconds)
        self._corruptions = job.corruptions
        self._options = job.measuring
        self._folder = None if job.folder is None else RunFolder(job.folder)
        self._kept, self._first, self._asked_twice = job.kept, job.first, job.asked_twice
        self._misread: dict[str, Misread] = {}
        self._differs = False
        self._batch_size = job.batch_size
        self._seconds = seconds
        self._samples: dict[str, OpenSample] = {}

    def release(self, needed: Container[str]) -> None:
        """Free the memory of all samples but those needed."""
        self._samples = {key: opened for key, opened in self._samples.items() if key in needed}

    def open(self, key: str) -> OpenSample:
        """Return a sample, with its clean flow if that is known or another worker has stored it."""
        if key not in self._samples:
            opened = self._samples[key] = self.frames.load(key)
            clean = None if self._folder is None else read_array(self._folder.clean_path(key), key)
            if clean is not None:
                self.set_clean(opened, clean, stored=True)
        return self._samples[key]

    def request_clean(self, sample: Sample) -> PredictionRequest:
        return self.frames.request(sample, (sample.key, CLEAN, 0), sample.frames)

    def set_clean(self, opened: OpenSample, clean: Answer, stored: bool = False) -> None:
        """Set the clean flow of a sample, and store it for other workers; its row must be the one that the run already
        has, if any."""
        key, opened.clean, opened.requested = opened.sample.key, clean, True
        if self._folder is not None and not stored:
            write_array(self._folder.clean_path(key), clean, key)
        if key in self._kept:
            check_same(self._kept[key], self._clean_row(opened))

    def rows(self, unit: Unit) -> Steps:
        """Return the rows of a unit that is no attack, in the order of its severities."""
        opened = self.open(unit.key)
        if not opened.requested:
            opened.requested = True
            answers = yield [self.request_clean(opened.sample)]
            assert answers is not None
            self.set_clean(opened, answers[0])
            if self._asked_twice and unit.cells[0] == (self._first, CLEAN, 0):
                yield []
                answers = yield [replace(self.request_clean(opened.sample), again=True)]
                assert answers is not None
                assert opened.clean is not None
                self._differs = not np.array_equal(answers[0], opened.clean, equal_nan=True)
        if unit.corruption == CLEAN:
            if unit.key == self._first:
                self._misread = misread_flows(opened.sample, opened.clean_flow)
            return [self._clean_row(opened)]
        rows = []
        for start in range(0, len(unit.cells), self._batch_size):
            yield []
            cells, digests = unit.cells[start : start + self._batch_size], list[str]()
            answers = yield [self._request(opened, cell, digests) for cell in cells]
            assert answers is not None
            rows += [self.row(opened, *of_cell) for of_cell in zip(answers, digests, cells, strict=True)]
            del answers  # free the memory, which the frames of the next cells can use
        return rows

    def finished(self, unit: Unit, rows: Rows) -> FinishedUnit:
        """Return a unit with the seconds since the previous one was finished."""
        wrong, differs = self._misread, self._differs
        self._misread, self._differs = {}, False
        seconds = dict(self._seconds)
        self._seconds.clear()
        return FinishedUnit(unit, rows, seconds, wrong, differs)

    def predicted(self, seconds: float) -> None:
        """Count the seconds that a prediction took."""
        self._seconds["predict"] += seconds

    def _request(self, opened: OpenSample, cell: Cell, digests: list[str]) -> PredictionRequest:
        """Return the request for a cell, and add the digest of its frames to a list."""
        frames = self.frames.corrupt(opened.sample, *cell[1:])
        digests.append(self.digest(frames))
        return self.frames.request(opened.sample, cell, frames)

    def digest(self, frames: tuple[Frame, ...]) -> str:
        with timed(self._seconds, "measure"):
            return frames_digest(frames[:2])

    def _clean_row(self, opened: OpenSample) -> dict[str, Any]:
        assert opened.clean is not None
        sample = opened.sample
        return self.row(opened, opened.clean, self.digest(sample.frames), (sample.key, CLEAN, 0))

    def row(self, opened: OpenSample, answer: Answer, digest: str, cell: Cell) -> dict[str, Any]:
        """Measure the flow of a cell, whose frames have this digest."""
        _, corruption, severity = cell
        truth = self._corruptions[corruption].truth if corruption in self._corruptions else "unchanged"
        sample, regions = opened.sample, opened.regions
        if truth != "unchanged":
            sample, regions = sample.without_truth(), None
        with memory_errors_named(describe_cell(*cell)), timed(self._seconds, "measure"):
            flow, clean_flow = flow_of(answer), opened.clean_flow
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


@dataclass(eq=False)
class Task:
    """A unit in progress."""

    unit: Unit
    steps: Steps
    waits: bool = False
    """Whether it has requested flows that have not arrived."""
    measured: int = 0
    """Number of steps for which flows have arrived."""

    def step(self, answers: list[Answer] | Exception | None, predict: Predict) -> None:
        """Take a step, with the flows requested by the last one; after the last step, raise StopIteration(rows)."""
        self.measured += answers is not None
        requests = self.steps.throw(answers) if isinstance(answers, Exception) else self.steps.send(answers)
        self.waits = bool(requests)
        if requests:
            predict(self, requests)


class Ready(NamedTuple):
    """A task that can take a step, with the flows that it has requested or the error that the model raised, and the
    seconds of the prediction."""

    task: Task
    answers: list[Answer] | Exception | None = None
    seconds: float = 0.0


Receive = Callable[[Task | None], Iterable[Unit | Ready]]
"""Yields new units, tasks whose flows have arrived, or the given task, which needs no flow; waits if there is none of
these. Nothing if no unit is left."""
Predict = Callable[[Task, list[PredictionRequest]], None]
"""Starts to predict the flows that a task has requested."""


def compute_units(computation: Computation, receive: Receive, predict: Predict) -> Iterator[FinishedUnit]:
    """Compute units that are no attacks. Before an error is raised, the tasks before the failed one are finished."""
    tasks: list[Task] = []
    error: Exception | None = None
    received = True
    while received and (tasks or error is None):
        received = False
        for message in receive(_next(tasks)):
            received = True
            if isinstance(message, Unit):
                if error is None:
                    computation.release({message.key, *(task.unit.key for task in tasks)})
                    tasks.append(Task(message, computation.rows(message)))
                continue
            task, answers, seconds = message
            computation.predicted(seconds)
            try:
                if task in tasks:
                    task.step(answers, predict)
            except StopIteration as end:
                tasks.remove(task)
                yield computation.finished(task.unit, end.value)
            except Exception as first_so_far:
                error, tasks = first_so_far, tasks[: tasks.index(task)]
            del message, answers  # free the memory of the flows
    if error is not None:
        raise error


def _next(tasks: Sequence[Task]) -> Task | None:
    """Return the next task that waits for no flow: of the oldest sample, each in turn, so that one slow corruption does
    not keep the model waiting."""
    ready = [task for task in tasks if not task.waits]
    of_sample = [task for task in ready if task.unit.key == ready[0].unit.key]
    return min(of_sample, key=lambda task: task.measured, default=None)
