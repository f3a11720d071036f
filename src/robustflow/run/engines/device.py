"""The two sides of a model on an accelerator: a process that only predicts, and feeders that corrupt frames and
measure flows. They share memory, in which each batch of a feeder has a place.

The memory is anonymous (`memfd_create`), so it is always freed when both processes have ended, and it is not limited by
/dev/shm, which has 64 MB in a container.
"""

from __future__ import annotations

import mmap
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import DupFd
from typing import Any

import numpy as np

from ...core.errors import RunError
from ...metrics.rows import CLEAN
from ...models.calls import describe_cell
from ...models.confidence import CHANNELS, Answer
from ..computation import Computation, Ready, Task, compute_units
from ..manifest import Cell
from ..plan import Job, NamedModel, Unit
from ..stages import PredictionRequest, PredictStage, Seconds, timed
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


def feed_forever(driver: Connection, sent: bytes, device: Connection, batches: list[SharedBatch]) -> None:
    """Corrupt and measure cells until the driver ends this process; the main function of a feeder."""
    job: Job = unpickled(sent)
    seconds = Seconds(float)
    feeder = Feeder(driver, job, seconds, device, batches)
    for done in compute_units(Computation(job, seconds), feeder.receive, feeder.predict):
        driver.send(("rows", done))


class Feeder:
    """Let another process predict flows, in batches of one sample."""

    def __init__(
        self, driver: Connection, job: Job, seconds: Seconds, device: Connection, batches: list[SharedBatch]
    ) -> None:
        self._driver, self._device, self._batches = driver, device, batches
        self._batch_size = job.batch_size
        self._channels = 3 if job.measuring.draws > 1 else CHANNELS[job.measuring.confidence]
        self._seconds = seconds
        self._free = deque(range(len(batches)))
        self._filling: list[tuple[Task, SharedRequest]] = []
        """The batch that is being filled, in the first of the free places."""
        self._in_flight: deque[tuple[int, list[tuple[Task, SharedRequest]]]] = deque()
        self._answers: dict[Task, dict[Cell, Answer | None]] = {}
        """The requested cells of each task in order, with the answers that have arrived."""

    def receive(self, task: Task | None) -> Iterator[Unit | Ready]:
        received = False
        while not received:
            waits = task is None or len(self._free) < 2
            if waits and not self._in_flight:
                self._send()
            arrived = wait([self._device, self._driver], timeout=None if waits else 0)
            for message in chain.from_iterable(map(self._messages, arrived)):
                received = True
                yield message
            if task is not None and not arrived:
                self._driver.send(("doing", describe_cell(task.unit.key, task.unit.corruption, *task.unit.severities)))
                yield Ready(task)
                return

    def predict(self, task: Task, requests: list[PredictionRequest]) -> None:
        self._answers[task] = {request.cell: None for request in requests}
        for request in requests:
            self._request(task, request)

    def _request(self, task: Task, request: PredictionRequest) -> None:
        """Copy the frames of a cell into the current batch, and send the batch if it is full."""
        alone = request.cell[1] == CLEAN  # as in the other engines
        if self._filling and (alone or self._filling[0][0].unit.key != task.unit.key):
            self._send()
        shape = (len(request.frames), *request.frames[0].shape)
        size = max(shape[0] * 3, 4 * self._channels) * shape[1] * shape[2]
        begin = len(self._filling) * size
        batch = self._batches[self._free[0]]
        batch.reserve(begin + size)
        with timed(self._seconds, "predict"):
            np.stack(request.frames, out=batch.array(begin, shape, np.uint8))
        self._filling.append((task, SharedRequest(replace(request, frames=()), begin, shape)))
        if alone or len(self._filling) == self._batch_size:
            self._send()

    def _send(self) -> None:
        if self._filling:
            index = self._free.popleft()
            with suppress(OSError):  # reported when the flows are received
                self._device.send((index, [shared for _, shared in self._filling]))
            self._in_flight.append((index, self._filling))
            self._filling = []

    def _messages(self, sender: object) -> Iterator[Unit | Ready]:
        """Yield the unit from the driver, or the tasks whose flows have all arrived, which may use the place of the
        batch until the next message."""
        if sender is self._driver:
            yield self._driver.recv()
            return
        try:
            self._seconds["predict"] += self._device.recv()
        except (EOFError, ConnectionError):
            while True:  # the predicting process has ended: the driver reports the reason and ends this process
                self._driver.recv()
        index, batch = self._in_flight.popleft()
        for task, shared in batch:
            answers = self._answers[task]
            shape = (*shared.shape[1:3], self._channels)
            flow: Answer = self._batches[index].array(shared.begin, shape, np.float32)
            kept = len(answers) > 1 or shared.request.cell[1] == CLEAN  # longer than the place of the batch
            answers[shared.request.cell] = flow.copy() if kept else flow
            arrived = [answer for answer in answers.values() if answer is not None]
            if len(arrived) == len(answers):
                del self._answers[task]
                yield Ready(task, arrived)
        self._free.append(index)
