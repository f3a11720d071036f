"""The two sides of a model on an accelerator: a process that only predicts, and feeders that corrupt frames and
measure flows. They share memory, in which each batch of a feeder has a place.

The memory is anonymous (`memfd_create`), so it is always freed when both processes have ended, and it is not limited by
/dev/shm, which has 64 MB in a container.
"""

from __future__ import annotations

import mmap
import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import DupFd
from typing import Any

import numpy as np

from ...core.errors import RunError
from ...metrics.rows import CLEAN
from ...models.base import describe_cell
from ...models.confidence import CHANNELS, Answer
from ..cells import Cell
from ..plan import Job, NamedModel, Unit
from ..stages import PredictionRequest, PredictStage, Seconds, timed
from ..worker import Computation, Steps
from .base import unpickled

BATCHES_PER_FEEDER = 4
"""Number of batches that a feeder fills or has in flight; one is kept free for a batch that must be separate."""


class SharedBatch:
    """Memory shared by two processes, for the frames of a batch and then for its flows."""

    def __init__(self, descriptor: int | None = None) -> None:
        self._descriptor = os.memfd_create("robustflow-batch") if descriptor is None else descriptor
        self._map: mmap.mmap | None = None

    def __reduce__(self) -> tuple[Callable[[Any], SharedBatch], tuple[Any]]:
        return _attached, (DupFd(self._descriptor),)

    def close(self) -> None:
        """Release the memory in this process; existing arrays remain valid."""
        os.close(self._descriptor)
        self._map = None

    def reserve(self, size: int) -> None:
        """Enlarge the memory to at least `size` bytes, so that a lack of memory is reported here and not by a crash."""
        if size <= os.fstat(self._descriptor).st_size:
            return
        try:
            os.posix_fallocate(self._descriptor, 0, size)
        except OSError as error:
            raise RunError(
                f"not enough memory for the frames sent to the model ({error.strerror}); try fewer --workers or a "
                "smaller --batch-size"
            ) from error

    def array(self, begin: int, shape: Sequence[int], dtype: Any) -> Any:
        """Return the array that starts at a byte of the memory."""
        count = int(np.prod(shape))
        if self._map is None or len(self._map) < begin + count * np.dtype(dtype).itemsize:
            self._map = mmap.mmap(self._descriptor, os.fstat(self._descriptor).st_size)
        return np.frombuffer(self._map, dtype, count, begin).reshape(shape)


def _attached(descriptor: Any) -> SharedBatch:
    return SharedBatch(descriptor.detach())


@dataclass(frozen=True)
class SharedRequest:
    """A `PredictionRequest` without its frames, which are in a `SharedBatch`; its flow replaces them."""

    request: PredictionRequest
    begin: int
    shape: tuple[int, int, int, int]


Link = tuple[Connection, list[SharedBatch]]
"""A connection to one feeder. It receives the index of a batch with a list of `SharedRequest`, and sends the seconds
that the prediction took, in the same order."""


def predict_forever(driver: Connection, sent: bytes, confidence: str | None, links: list[Link]) -> None:
    """Predict batches in the order in which they arrive; the main function of a predicting process."""
    model: NamedModel = unpickled(sent)
    stage = PredictStage(model.load(), confidence, lambda what: driver.send(("doing", what)))
    batches = dict(links)
    waiting: deque[tuple[Connection, int, list[SharedRequest]]] = deque()
    while True:
        for ready in wait([driver, *batches], timeout=0 if waiting else None):
            assert isinstance(ready, Connection)
            if ready is driver:
                driver.recv()  # raises EOFError, because the other end sends nothing before it closes
                continue
            try:
                waiting.append((ready, *ready.recv()))
            except (EOFError, ConnectionError):  # the driver notices when a feeder ends
                del batches[ready]
        if waiting:
            link, index, requests = waiting.popleft()
            if link not in batches:
                continue
            seconds = _answer(stage, batches[link][index], requests)
            try:
                link.send(seconds)
            except OSError:
                del batches[link]


def _answer(stage: PredictStage, batch: SharedBatch, requests: list[SharedRequest]) -> float:
    given = [replace(one.request, frames=tuple(batch.array(one.begin, one.shape, np.uint8))) for one in requests]
    flows, seconds = stage.predict(given)
    for one, flow in zip(requests, flows, strict=True):
        batch.array(one.begin, flow.shape, np.float32)[:] = flow
    return seconds


@dataclass(eq=False)
class _Running:
    """A unit, and the flows that its computation is waiting for."""

    unit: Unit
    steps: Steps[list[dict[str, Any]]]
    answers: dict[Cell, Answer | None] = field(default_factory=dict)
    """The requested cells in order, with the answers that have arrived; empty if the next step can be taken."""
    finished: int = 0
    """Number of cells that have been measured."""


def feed_forever(driver: Connection, sent: bytes, device: Connection, batches: list[SharedBatch]) -> None:
    """Corrupt and measure cells until the driver ends this process; the main function of a feeder."""
    feeder = Feeder(driver, unpickled(sent), device, batches)
    while True:
        feeder.step()


class Feeder:
    """The units of a feeder, and the batches whose flows it is waiting for."""

    def __init__(self, driver: Connection, job: Job, device: Connection, batches: list[SharedBatch]) -> None:
        self._driver, self._device, self._batches = driver, device, batches
        self._batch_size = job.batch_size
        self._channels = 3 if job.measuring.draws > 1 else CHANNELS[job.measuring.confidence]
        self._seconds = Seconds(float)
        self._computation = Computation(job, self._seconds)
        self._units: list[_Running] = []
        self._free = deque(range(len(batches)))
        self._filling: list[tuple[_Running, SharedRequest]] = []
        """The batch that is being filled, in the first of the free places."""
        self._in_flight: deque[tuple[int, list[tuple[_Running, SharedRequest]]]] = deque()

    def step(self) -> None:
        """Process messages that have arrived; otherwise prepare the frames of one unit; otherwise wait."""
        running = self._next_unit() if len(self._free) > 1 else None
        if running is None and not self._in_flight:
            self._send()
        for ready in wait([self._device, self._driver], timeout=None if running is None else 0):
            if ready is self._driver:
                unit: Unit = self._driver.recv()
                self._units.append(_Running(unit, self._computation.rows(unit)))
            else:
                self._receive()
            return
        if running is not None:
            unit = running.unit
            self._driver.send(("doing", describe_cell(unit.key, unit.corruption, *unit.severities)))
            self._continue(running)

    def _next_unit(self) -> _Running | None:
        """Return the next unit that waits for no flow: of the oldest sample, each in turn."""
        waiting = [one for one in self._units if not one.answers]
        of_sample = [one for one in waiting if one.unit.key == waiting[0].unit.key]
        return min(of_sample, key=lambda one: one.finished, default=None)

    def _continue(self, running: _Running) -> None:
        """Take the next step of a unit: request flows, or measure those that have arrived and send its rows."""
        answers = [answer for answer in running.answers.values() if answer is not None]
        running.answers, running.finished = {}, running.finished + len(answers)
        try:
            requests = running.steps.send(answers) if answers else next(running.steps)
        except StopIteration as end:
            self._driver.send(("rows", self._computation.finished(running.unit, end.value)))
            self._units.remove(running)
            self._computation.release({running.unit.key, *(one.unit.key for one in self._units)})
            return
        for request in requests:
            running.answers[request.cell] = None
            self._request(running, request)

    def _request(self, running: _Running, request: PredictionRequest) -> None:
        """Copy the frames of a cell into the current batch, and send the batch if it is full."""
        alone = request.cell[1] == CLEAN  # as in the other engines
        if self._filling and (alone or self._filling[0][0].unit.key != running.unit.key):
            self._send()
        shape = (len(request.frames), *request.frames[0].shape)
        size = max(shape[0] * 3, 4 * self._channels) * shape[1] * shape[2]
        begin = len(self._filling) * size
        batch = self._batches[self._free[0]]
        batch.reserve(begin + size)
        with timed(self._seconds, "predict"):
            np.stack(request.frames, out=batch.array(begin, shape, np.uint8))
        self._filling.append((running, SharedRequest(replace(request, frames=()), begin, shape)))
        if alone or len(self._filling) == self._batch_size:
            self._send()

    def _send(self) -> None:
        if self._filling:
            index = self._free.popleft()
            with suppress(OSError):  # reported when the flows are received
                self._device.send((index, [shared for _, shared in self._filling]))
            self._in_flight.append((index, self._filling))
            self._filling = []

    def _receive(self) -> None:
        """Continue the units whose flows have arrived; none requests flows before the place of this batch is free."""
        try:
            predicting = self._device.recv()
        except (EOFError, ConnectionError):
            while True:  # the predicting process has ended: the driver reports the reason and ends this process
                self._driver.recv()
        index, batch = self._in_flight.popleft()
        self._seconds["predict"] += predicting
        for running, shared in batch:
            shape = (*shared.shape[1:3], self._channels)
            flow: Answer = self._batches[index].array(shared.begin, shape, np.float32)
            kept = len(running.answers) > 1 or shared.request.cell[1] == CLEAN  # longer than the place of the batch
            running.answers[shared.request.cell] = flow.copy() if kept else flow
            if all(answer is not None for answer in running.answers.values()):
                self._continue(running)
        self._free.append(index)
