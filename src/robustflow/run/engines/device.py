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
from ...core.types import Frame
from ...metrics.rows import CLEAN
from ...models import ModelSpec
from ...models.base import AnyModel, describe_cell
from ...models.confidence import CHANNELS, Answer
from ..cells import Cell
from ..plan import Unit
from ..stages import FrameStage, OpenSample, PredictionRequest, PredictStage, no_seconds, pop_timings, timed
from ..worker import Job, MeasureStage

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


def predict_forever(driver: Connection, model: ModelSpec | AnyModel, confidence: str | None, links: list[Link]) -> None:
    """Predict batches in the order in which they arrive; the main function of a predicting process."""
    seconds = no_seconds()
    loaded = model.load() if isinstance(model, ModelSpec) else model
    stage = PredictStage(loaded, confidence, seconds, lambda what: driver.send(("doing", what)))
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
            _answer(stage, batches[link][index], requests)
            try:
                link.send(pop_timings(seconds)["predict"])
            except OSError:
                del batches[link]


def _answer(stage: PredictStage, batch: SharedBatch, requests: list[SharedRequest]) -> None:
    given = [replace(one.request, frames=tuple(batch.array(one.begin, one.shape, np.uint8))) for one in requests]
    for one, flow in zip(requests, stage.predict(given), strict=True):
        batch.array(one.begin, flow.shape, np.float32)[:] = flow


@dataclass(frozen=True)
class _Sent:
    """A cell whose flow has been requested."""

    opened: OpenSample
    shared: SharedRequest
    digest: str
    wanted: bool
    """Whether a row is needed; the row of a clean flow may already exist."""


@dataclass
class _OpenUnit:
    """A unit whose cells are prepared and measured."""

    unit: Unit
    cells: deque[Cell]
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)


def feed_forever(driver: Connection, job: Job, device: Connection, batches: list[SharedBatch]) -> None:
    """Corrupt and measure cells until the driver ends this process; the main function of a feeder."""
    feeder = Feeder(driver, job, device, batches)
    while True:
        feeder.step()


class Feeder:
    """The units of a feeder, and the batches whose flows it is waiting for."""

    def __init__(self, driver: Connection, job: Job, device: Connection, batches: list[SharedBatch]) -> None:
        self._driver, self._device, self._batches = driver, device, batches
        self._batch_size = job.batch_size
        self._channels = 3 if job.options.measuring.draws > 1 else CHANNELS[job.options.measuring.confidence]
        self._seconds = no_seconds()
        self._frames = FrameStage(job.dataset, job.options, self._seconds)
        self._measure = MeasureStage(job, self._seconds)
        self._units: dict[tuple[str, str], _OpenUnit] = {}
        self._samples: dict[str, OpenSample] = {}
        self._free = deque(range(len(batches)))
        self._filling: list[_Sent] = []
        """The batch that is being filled, in the first of the free places."""
        self._in_flight: deque[tuple[int, list[_Sent]]] = deque()

    def step(self) -> None:
        """Process messages that have arrived; otherwise prepare the frames of one cell; otherwise wait."""
        unit = self._next_unit() if len(self._free) > 1 else None
        if unit is None and not self._in_flight:
            self._send()
        for ready in wait([self._device, self._driver], timeout=None if unit is None else 0):
            if ready is self._driver:
                given: Unit = self._driver.recv()
                self._units[given.key, given.corruption] = _OpenUnit(given, deque(given.cells))
            else:
                self._measure_batch()
            return
        if unit is not None:
            self._prepare(unit)

    def _next_unit(self) -> _OpenUnit | None:
        """Return the unit with the next cell: of the oldest sample, first the clean unit, then each in turn."""
        waiting = [one for one in self._units.values() if one.cells]
        of_sample = [one for one in waiting if one.unit.key == waiting[0].unit.key]
        return max(of_sample, key=lambda one: (one.unit.corruption == CLEAN, len(one.cells)), default=None)

    def _prepare(self, unit: _OpenUnit) -> None:
        cell = unit.cells[0]
        key, corruption, severity = cell
        self._driver.send(("doing", describe_cell(*cell)))
        if key not in self._samples:
            opened = self._samples[key] = self._frames.load(key)
            self._measure.read_clean(opened)
            if opened.clean is None:
                clean_cell = (key, CLEAN, 0)
                self._send()
                self._request(opened, clean_cell, opened.sample.frames, wanted=cell == clean_cell)
                self._send()  # predicted alone, as in the other engines
                if cell == clean_cell:
                    unit.cells.popleft()
            return
        opened = self._samples[key]
        unit.cells.popleft()
        if corruption == CLEAN:
            assert opened.clean is not None
            self._measure_cell(opened, cell, opened.clean, self._measure.digest(opened.sample.frames))
        else:
            self._request(opened, cell, self._frames.corrupt(opened.sample, corruption, severity), wanted=True)

    def _request(self, opened: OpenSample, cell: Cell, frames: tuple[Frame, ...], wanted: bool) -> None:
        """Copy the frames of a cell into the current batch, and send the batch if it is full."""
        if self._filling and self._filling[0].opened is not opened:
            self._send()
        digest = self._measure.digest(frames)
        request = self._frames.request(opened.sample, cell, frames)
        shape = (len(request.frames), *request.frames[0].shape)
        height, width = opened.sample.shape
        size = max(shape[0] * 3, 4 * self._channels) * height * width
        begin = len(self._filling) * size
        batch = self._batches[self._free[0]]
        batch.reserve(begin + size)
        with timed(self._seconds, "predict"):
            np.stack(request.frames, out=batch.array(begin, shape, np.uint8))
        self._filling.append(_Sent(opened, SharedRequest(replace(request, frames=()), begin, shape), digest, wanted))
        if len(self._filling) == self._batch_size:
            self._send()

    def _send(self) -> None:
        if self._filling:
            index = self._free.popleft()
            with suppress(OSError):  # reported when the flows are received
                self._device.send((index, [sent.shared for sent in self._filling]))
            self._in_flight.append((index, self._filling))
            self._filling = []

    def _measure_batch(self) -> None:
        try:
            predicting = self._device.recv()
        except (EOFError, ConnectionError):
            while True:  # the predicting process has ended: the driver reports the reason and ends this process
                self._driver.recv()
        index, batch = self._in_flight.popleft()
        self._seconds["predict"] += predicting
        for sent in batch:
            cell = sent.shared.request.cell
            shape = (*sent.opened.sample.shape, self._channels)
            flow: Answer = self._batches[index].array(sent.shared.begin, shape, np.float32)
            if cell[1] == CLEAN:
                self._measure.keep_clean(sent.opened, flow.copy())
            if sent.wanted:
                self._measure_cell(sent.opened, cell, flow, sent.digest)
        self._free.append(index)

    def _measure_cell(self, opened: OpenSample, cell: Cell, flow: Answer, digest: str) -> None:
        """Measure a row, and send the rows of its unit if it is the last. The clean flow is known, because it was
        requested first and the device answers in order."""
        key, corruption, severity = cell
        open_unit = self._units[key, corruption]
        open_unit.rows[severity] = self._measure.row(opened, flow, digest, cell)
        unit = open_unit.unit
        if len(open_unit.rows) == len(unit.severities):
            rows = [open_unit.rows[severity] for severity in unit.severities]
            self._driver.send(("rows", (unit, rows, pop_timings(self._seconds))))
            del self._units[key, corruption]
        needed = {key, *(other for other, _ in self._units)}
        self._samples = {name: one for name, one in self._samples.items() if name in needed}
