"""Run one predicting process per device, and feeder processes that corrupt frames and measure flows.

The feeders of a device exchange frames and flows with it directly through shared memory; the driver assigns cells,
monitors the processes, and is the only process that writes rows. The number of frames in flight is bounded by the slots
of each feeder: a feeder without a free slot waits.
"""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing.connection import wait
from typing import Any

from ...child import Child
from ...models import ModelSpec
from ...models.base import describe_cell
from ...runs.cells import Cell
from ...runs.plan import Unit
from .base import FinishedUnit, FinishedUnits, Job, pickled
from .cell_schedule import CellSchedule
from .feeder import cells_ahead, feed_forever
from .prediction_timeout import PredictionTimeout
from .predictor import Link, predict_forever
from .shared_slots import SharedSlots


def staged(
    job: Job, units: Sequence[Unit], devices: Sequence[str], feeders: int, timeout: float | None = None
) -> FinishedUnits:
    """Compute the units."""
    pickled(job)
    schedule = CellSchedule(units)
    predictors: list[_PredictorHandle] = []
    pool: list[_FeederHandle] = []
    links = [multiprocessing.Pipe() for _ in range(feeders)]
    slots = [SharedSlots(2 * job.batch_size + 2) for _ in range(feeders)]
    try:
        try:
            for number, device in enumerate(devices):
                mine = range(number, feeders, len(devices))
                theirs = [(links[feeder][1], slots[feeder]) for feeder in mine]
                predictors.append(_PredictorHandle(job, device if len(devices) > 1 else None, theirs, timeout))
            for (link, _), memory in zip(links, slots, strict=True):
                pool.append(_FeederHandle(job, link, memory))
        finally:
            for ends, memory in zip(links, slots, strict=True):
                ends[0].close()
                ends[1].close()
                memory.close()
        children: dict[Any, _PredictorHandle | _FeederHandle] = {one.child.pipe: one for one in predictors}
        children |= {one.child.pipe: one for one in pool}
        for feeder in pool:
            feeder.send_cells(schedule)
        while not schedule.finished:
            ready = wait(list(children), timeout=0.2 if timeout else None)
            for predictor in predictors:
                if predictor.child.pipe not in ready:
                    predictor.timeout.check()
            for pipe in ready:
                done = children[pipe].handle_message(schedule)
                for feeder in pool:
                    feeder.send_cells(schedule)
                if done is not None:
                    yield done
    finally:
        for child in [one.child for one in predictors] + [one.child for one in pool]:
            child.end()


class _PredictorHandle:
    """The predicting process of a device."""

    def __init__(self, job: Job, device: str | None, links: list[Link], timeout: float | None) -> None:
        model = job.model.on(device) if isinstance(job.model, ModelSpec) and device is not None else job.model
        self.child = Child(predict_forever, model, job.options.confidence, links)
        self.timeout = PredictionTimeout(timeout)

    def handle_message(self, schedule: CellSchedule) -> None:
        """Process one message."""
        doing = self.timeout.what or "nothing"
        self.timeout.note(self.child.receive(doing, "try a smaller --batch-size")[1])


class _FeederHandle:
    """A feeder and its cells."""

    def __init__(self, job: Job, link: Any, slots: SharedSlots) -> None:
        self.child = Child(feed_forever, replace(job, model=ModelSpec("none")), link, slots)
        self._asked = cells_ahead(job.batch_size)
        """Number of requests that have not been answered yet."""
        self._deferred = 0
        """Number of requests that were answered with "none"."""
        self._last_key: str | None = None
        self._has_backlog = False
        self._unmade: deque[Cell] = deque()
        """Cells assigned to the feeder whose frames are not prepared yet, in processing order."""

    def handle_message(self, schedule: CellSchedule) -> FinishedUnit | None:
        """Read one message, and return the unit that it completes, if any."""
        doing = describe_cell(*self._unmade[0]) if self._unmade else "the last rows"
        kind, value = self.child.receive(doing, "try fewer --workers")
        if kind == "made":
            corruption, seconds, self._has_backlog = value
            self._unmade.popleft()
            schedule.learn(corruption, seconds)
            self._asked += 1
            return None
        return schedule.finish(*value)

    def send_cells(self, schedule: CellSchedule) -> None:
        """Send the feeder as many of the requested cells as are available."""
        while self._asked or self._deferred:
            cell = schedule.take(self._last_key, self._has_backlog)
            if cell is not None:
                self._last_key = cell[0]
                self._unmade.append(cell)
            elif not self._asked:
                return
            if self._asked:
                self._asked -= 1
                self._deferred += cell is None
                self.child.send(("none", None) if cell is None else ("cell", cell))
            else:
                self._deferred -= 1
                self.child.send(("deferred", cell))
