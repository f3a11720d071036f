"""Memory shared by two processes: slots of equal size, each of which contains the frames of a cell, then its flow.
A process that only predicts: it keeps the model on its device and shares memory with the device's feeders. A
process that corrupts frames and measures flows, while another process runs the model.

The memory is anonymous (`memfd_create`), so it is always freed when both processes have ended, and it is not limited by
/dev/shm, which has 64 MB in a container. A slot takes up no memory until its first use.
"""

from __future__ import annotations

import mmap
import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import DupFd
from typing import Any

import numpy as np

from ...core.errors import RunError
from ...core.types import Flow, Frame
from ...metrics.rows import CLEAN
from ...models import ModelSpec
from ...models.base import AnyModel
from ...models.confidence import CHANNELS, Answer
from ..cells import Cell
from ..frame_stage import FrameStage, Loaded
from ..measure_stage import MeasureStage
from ..predict_stage import PredictionRequest, PredictStage
from ..seconds import no_seconds, pop_timings, timed
from .base import Job

BUDGET = 128 * 2**20
"""Maximum total size of a feeder's slots in bytes; exceeded only if the minimum number of slots needs more."""
MOST_SLOTS = 64
_PAGE = 4096


class SharedSlots:
    """Slots into which a feeder writes frames, and in which a predicting process replaces the frames with their
    flow.
    """

    def __init__(self, fewest: int) -> None:
        self._attach(os.memfd_create("robustflow-slots"), fewest)

    def _attach(self, descriptor: int, fewest: int) -> None:
        self._descriptor = descriptor
        self._fewest = fewest
        self._map: mmap.mmap | None = None
        self._free: list[int] = []
        self._used: set[int] = set()
        self.count = 0
        """Number of slots, free and used."""
        self.slot_bytes = 0
        """Size of a slot in bytes."""

    def __reduce__(self) -> tuple[Callable[..., SharedSlots], tuple[Any, int]]:
        return _attached, (DupFd(self._descriptor), self._fewest)

    def close(self) -> None:
        """Release the memory in this process; existing views remain valid."""
        os.close(self._descriptor)
        self._map = None

    # Methods used by the feeder.

    @property
    def free(self) -> int:
        """Return the number of free slots."""
        return len(self._free)

    @property
    def in_use(self) -> int:
        """Return the number of slots in use."""
        return self.count - len(self._free)

    def fit(self, size: int) -> bool:
        """Enlarge the slots to at least `size` bytes; return False if this has to wait until no slot is in use."""
        if size <= self.slot_bytes:
            return True
        if self.in_use:
            return False
        self.slot_bytes = -(-size // _PAGE) * _PAGE
        self.count = max(self._fewest, min(MOST_SLOTS, BUDGET // self.slot_bytes))
        self._free = list(range(self.count))[::-1]
        self._used = set()
        whole = max(self.count * self.slot_bytes, os.fstat(self._descriptor).st_size)
        os.ftruncate(self._descriptor, whole)  # reserved so that each process maps it once; takes up no memory yet
        return True

    def take(self) -> int:
        """Return the most recently used free slot, so that fewer slots take up memory."""
        slot = self._free.pop()
        if slot not in self._used:
            try:
                os.posix_fallocate(self._descriptor, slot * self.slot_bytes, self.slot_bytes)
            except OSError as error:
                raise RunError(
                    f"not enough memory for the frames sent to the model ({error.strerror}); try fewer --workers or a "
                    "smaller --batch-size"
                ) from error
            self._used.add(slot)
        return slot

    def put_back(self, slot: int) -> None:
        """Release a slot."""
        self._free.append(slot)

    # Both sides.

    def frames(self, slot: int, slot_bytes: int, shape: Sequence[int]) -> Frame:
        """Return a view of the frames in a slot, uint8 (count, H, W, 3)."""
        return self._view(slot, slot_bytes, shape, np.uint8)

    def flow(self, slot: int, slot_bytes: int, shape: Sequence[int]) -> Flow:
        """Return a view of the flow in a slot, float32 (H, W, 2), in pixels."""
        return self._view(slot, slot_bytes, shape, np.float32)

    def _view(self, slot: int, slot_bytes: int, shape: Sequence[int], dtype: Any) -> Any:
        begin = slot * slot_bytes
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        if self._map is None or len(self._map) < begin + size:
            self._map = mmap.mmap(self._descriptor, os.fstat(self._descriptor).st_size)
        return np.frombuffer(self._map, dtype, int(np.prod(shape)), begin).reshape(shape)


def _attached(descriptor: Any, fewest: int) -> SharedSlots:
    slots = SharedSlots.__new__(SharedSlots)
    slots._attach(descriptor.detach(), fewest)
    return slots


@dataclass(frozen=True)
class SlotRequest:
    """A `PredictionRequest` whose frames are in a slot; the flow is written into the same slot."""

    cell: Cell
    slot: int
    slot_bytes: int
    shape: tuple[int, int, int, int]
    index: int | None
    draws: int


Link = tuple[Connection, SharedSlots]
"""A connection to one feeder. It receives lists of `SlotRequest` and sends the prediction time of each list in seconds,
in the same order."""


def predict_forever(driver: Connection, model: ModelSpec | AnyModel, confidence: str | None, links: list[Link]) -> None:
    """Predict batches in the order in which they arrive; the main function of a predicting process."""
    seconds = no_seconds()
    loaded = model.load() if isinstance(model, ModelSpec) else model
    stage = PredictStage(loaded, confidence, seconds, lambda what: driver.send(("predicting", what)))
    slots = dict(links)
    waiting: deque[tuple[Connection, list[SlotRequest]]] = deque()
    while True:
        for ready in wait([driver, *slots], timeout=0 if waiting else None):
            assert isinstance(ready, Connection)
            if ready is driver:
                driver.recv()  # raises EOFError, because the other end sends nothing before it closes
                continue
            try:
                waiting.append((ready, ready.recv()))
            except (EOFError, ConnectionError):  # the driver notices when a feeder ends
                del slots[ready]
        if waiting:
            link, batch = waiting.popleft()
            if link not in slots:
                continue
            _answer(stage, slots[link], batch)
            try:
                link.send(pop_timings(seconds)["predict"])
            except OSError:
                del slots[link]


def _answer(stage: PredictStage, slots: SharedSlots, batch: list[SlotRequest]) -> None:
    requests = [
        PredictionRequest(one.cell, tuple(slots.frames(one.slot, one.slot_bytes, one.shape)), one.index, one.draws)
        for one in batch
    ]
    for one, flow in zip(batch, stage.predict(requests), strict=True):
        slots.flow(one.slot, one.slot_bytes, flow.shape)[:] = flow


_OPEN_SAMPLES = 4
"""Maximum number of samples that a feeder keeps in memory while it waits for their flows."""


def cells_ahead(batch_size: int) -> int:
    """Number of cells that are assigned to a feeder in advance."""
    return batch_size + 2


@dataclass
class _OpenSample:
    """A sample in progress: its clean flow is known or has been requested."""

    loaded: Loaded
    slot_bytes: int
    clean: Answer | None = None
    unmeasured: int = 0
    """Cells whose flow has not arrived yet, including the clean cell."""


@dataclass(frozen=True)
class _Sent:
    """A request sent to the predicting process."""

    sample: _OpenSample
    request: SlotRequest
    digest: str
    wanted: bool
    """Whether a row is needed; the row of a clean flow may already exist."""


def feed_forever(driver: Connection, job: Job, device: Connection, slots: SharedSlots) -> None:
    """Corrupt and measure cells until the driver ends this process."""
    feeder = _Feeder(driver, job, device, slots)
    while True:
        feeder.step()


class _Feeder:
    """The cells of a feeder, and the predictions that it is waiting for."""

    def __init__(self, driver: Connection, job: Job, device: Connection, slots: SharedSlots) -> None:
        self._driver, self._device, self._slots = driver, device, slots
        self._batch_size = job.batch_size
        measuring = job.options.measuring
        self._channels = 3 if measuring.draws > 1 else CHANNELS[measuring.confidence]
        self._seconds = no_seconds()
        self._frames = FrameStage(job.dataset, job.options, self._seconds)
        self._measure = MeasureStage(job.options, job.clean_path, job.kept, self._seconds)
        self._queued_cells: deque[Cell] = deque()
        self._samples: dict[str, _OpenSample] = {}
        self._batch: list[_Sent] = []
        self._in_flight: deque[list[_Sent]] = deque()
        self._unanswered = cells_ahead(job.batch_size)
        """Number of requests that the driver has not answered yet."""

    def step(self) -> None:
        """Process messages that have arrived; otherwise prepare the frames of one cell; otherwise wait."""
        busy = bool(self._queued_cells) and self._can_make(self._queued_cells[0])
        if not busy:
            self._send_batch_unless_it_grows()
        for ready in wait([self._device, self._driver], timeout=0 if busy else None):
            if ready is self._driver:
                kind, cell = self._driver.recv()
                self._unanswered -= kind != "deferred"
                if cell is not None:
                    self._queued_cells.append(cell)
            else:
                self._take_flows()
            return
        if busy:
            self._make(self._queued_cells[0])

    def _can_make(self, cell: Cell) -> bool:
        """Return whether there is room for the frames of a cell; if not, the feeder waits for flows."""
        sample = self._samples.get(cell[0])
        if sample is None:
            return len(self._samples) < _OPEN_SAMPLES
        return self._slots.fit(sample.slot_bytes) and self._slots.free > 0

    def _make(self, cell: Cell) -> None:
        key, corruption, severity = cell
        if key not in self._samples:
            loaded = self._frames.load(key)
            self._samples[key] = _OpenSample(loaded, _slot_bytes(loaded, self._frames, self._channels))
            return  # may need larger slots first
        sample = self._samples[key]
        if sample.clean is None and not sample.unmeasured:
            self._find_clean(sample, cell)
            return
        before = self._seconds["corrupt"]
        if corruption == CLEAN:
            digest = self._measure.digest(sample.loaded.sample.frames)
            assert sample.clean is not None
            self._report(cell, sample, sample.clean, digest)
            before = self._seconds["corrupt"]  # the timer was reset when the row was sent
        else:
            frames = self._frames.corrupt(sample.loaded.sample, corruption, severity)
            self._ask(sample, cell, frames, wanted=True)
        self._report_sent(cell, self._seconds["corrupt"] - before)

    def _find_clean(self, sample: _OpenSample, cell: Cell) -> None:
        """Read the clean flow from disk, or request it; for a clean cell, this also requests the flow of the cell."""
        sample.clean = self._measure.stored_clean(sample.loaded)
        if sample.clean is not None:
            return
        wanted = cell[1] == CLEAN
        self._ask(sample, (cell[0], CLEAN, 0), sample.loaded.sample.frames, wanted)
        self._send_batch()  # predicted alone, as in the other engines
        if wanted:
            self._report_sent(cell, 0.0)

    def _report_sent(self, cell: Cell, cost: float) -> None:
        """Report that a cell was sent and that its frames took `cost` seconds, and request the next cell."""
        self._queued_cells.popleft()
        self._unanswered += 1
        has_backlog = 2 * self._slots.in_use >= self._slots.count
        self._driver.send(("made", (cell[1], cost, has_backlog)))

    def _ask(self, sample: _OpenSample, cell: Cell, frames: tuple[Frame, ...], wanted: bool) -> None:
        if self._batch and self._batch[0].sample is not sample:
            self._send_batch()
        digest = self._measure.digest(frames)
        request = self._frames.request(sample.loaded.sample, cell, frames)
        slot = self._slots.take()
        shape = (len(request.frames), *request.frames[0].shape)
        with timed(self._seconds, "predict"):
            np.stack(request.frames, out=self._slots.frames(slot, self._slots.slot_bytes, shape))
        where = SlotRequest(cell, slot, self._slots.slot_bytes, shape, request.index, request.draws)
        self._batch.append(_Sent(sample, where, digest, wanted))
        sample.unmeasured += 1
        if len(self._batch) == self._batch_size:
            self._send_batch()

    def _send_batch_unless_it_grows(self) -> None:
        """Send the prepared cells if no more can be prepared now, unless the driver is about to send the next cell."""
        if self._queued_cells or not self._unanswered:
            self._send_batch()

    def _send_batch(self) -> None:
        if self._batch:
            try:
                self._device.send([sent.request for sent in self._batch])
            except OSError:
                self._wait_for_the_end()
            self._in_flight.append(self._batch)
            self._batch = []

    def _take_flows(self) -> None:
        """Measure the flows of the oldest batch."""
        try:
            predicting = self._device.recv()
        except (EOFError, ConnectionError):
            self._wait_for_the_end()
        batch = self._in_flight.popleft()
        self._seconds["predict"] += predicting
        for sent in batch:
            request, sample = sent.request, sent.sample
            flow = self._slots.flow(request.slot, request.slot_bytes, (*sample.loaded.sample.shape, self._channels))
            if request.cell[1] == CLEAN:
                sample.clean = flow.copy()
                self._measure.keep_clean(sample.loaded, sample.clean)
            sample.unmeasured -= 1
            if sent.wanted:
                self._report(request.cell, sample, flow, sent.digest)
            self._slots.put_back(request.slot)

    def _report(self, cell: Cell, sample: _OpenSample, flow: Answer, digest: str) -> None:
        assert sample.clean is not None  # the device answers in order, and the clean flow was requested first
        row = self._measure.row(sample.loaded, sample.clean, flow, digest, cell)
        self._driver.send(("row", (cell, row, pop_timings(self._seconds))))
        needed = {key for key, *_ in self._queued_cells} | {cell[0]}
        for key in [key for key, one in self._samples.items() if not one.unmeasured and key not in needed]:
            del self._samples[key]

    def _wait_for_the_end(self) -> None:
        """Wait after the predicting process has ended: the driver reports the reason and ends this process."""
        while True:
            self._driver.recv()


def _slot_bytes(loaded: Loaded, frames: FrameStage, channels: int) -> int:
    """Return the size of the model's input or output in bytes, whichever is larger."""
    height, width = loaded.sample.shape
    given = frames.request(loaded.sample, (loaded.sample.key, CLEAN, 0), loaded.sample.frames)
    return max(len(given.frames) * 3, 4 * channels) * height * width
