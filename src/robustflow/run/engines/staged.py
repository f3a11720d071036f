"""Choose the next cell for each feeder, and track which units are finished. Run one predicting process per device,
and feeder processes that corrupt frames and measure flows.

A feeder continues with the sample it has loaded. The next cell depends on how many frames are waiting for the model: a
costly corruption if there are enough, a cheap one if they are running out. Slow corruptions (lens blur takes a second)
therefore never keep the model waiting, wherever they are in the plan; costs are measured during the run.

The feeders of a device exchange frames and flows with it directly through shared memory; the driver assigns cells,
monitors the processes, and is the only process that writes rows. The number of frames in flight is bounded by the slots
of each feeder: a feeder without a free slot waits.
"""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from typing import Any

from ...core.processes import Child
from ...metrics.rows import CLEAN
from ...models import ModelSpec
from ...models.base import describe_cell
from ..cells import Cell
from ..plan import Unit
from .base import FinishedUnit, FinishedUnits, Job, pickled
from .feeder import Link, SharedSlots, cells_ahead, feed_forever, predict_forever
from .processes import PredictionTimeout


@dataclass
class _Open:
    """A unit whose cells are being assigned."""

    unit: Unit
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class CellSchedule:
    """Assign each cell of the units once, and collect the rows."""

    def __init__(self, units: Iterable[Unit]) -> None:
        self._waiting: dict[str, list[Unit]] = {}
        """Units of samples that have not been started, in the plan's order."""
        for unit in units:
            self._waiting.setdefault(unit.key, []).append(unit)
        self._fresh = list(reversed(self._waiting))
        """Samples that no feeder has started, in reverse order."""
        self._cells: dict[str, list[Cell]] = {}
        """Remaining cells of the samples that were started."""
        self._blocked: set[str] = set()
        """Samples whose clean cell is being computed."""
        self._open: dict[tuple[str, str], _Open] = {}
        self._cost: dict[str, float] = {}

    @property
    def finished(self) -> bool:
        """Whether every unit is finished."""
        return not self._waiting and not self._open

    def take(self, last_key: str | None, has_backlog: bool) -> Cell | None:
        """Return the next cell for a feeder; None if all remaining cells have to wait."""
        key = last_key if last_key in self._cells else None
        if key is None and self._fresh:
            key = self._fresh.pop()
            self._begin(key)
        if key is None:
            key = next((key for key in self._cells if key not in self._blocked), None)
        if key is None:
            return None
        cells = self._cells[key]
        cell = cells.pop(self._choice(cells, has_backlog))
        if not cells:
            del self._cells[key]
        return cell

    def learn(self, corruption: str, seconds: float) -> None:
        """Record that preparing a cell's frames took `seconds`."""
        known = self._cost.get(corruption)
        self._cost[corruption] = seconds if known is None else 0.5 * (known + seconds)

    def finish(self, cell: Cell, row: dict[str, Any], seconds: dict[str, float]) -> FinishedUnit | None:
        """Accept the row of a cell and its cost, and return the unit if this was its last row."""
        key, corruption, severity = cell
        if corruption == CLEAN:
            self._blocked.discard(key)
        part = self._open[key, corruption]
        part.rows[severity] = row
        for kind, spent in seconds.items():
            part.seconds[kind] = part.seconds.get(kind, 0.0) + spent
        if len(part.rows) < len(part.unit.severities):
            return None
        del self._open[key, corruption]
        return FinishedUnit(part.unit, [part.rows[severity] for severity in part.unit.severities], part.seconds)

    def _begin(self, key: str) -> None:
        units = self._waiting.pop(key)
        self._open |= {(key, unit.corruption): _Open(unit) for unit in units}
        self._cells[key] = [cell for unit in units for cell in unit.cells]
        if units[0].corruption == CLEAN:
            self._blocked.add(key)

    def _choice(self, cells: list[Cell], has_backlog: bool) -> int:
        """Return the index of the next cell: the clean cell if it has not been assigned; with a backlog, the last cell
        of unknown cost, or the costliest; otherwise the cheapest cell of known cost, or the first."""
        if cells[0][1] == CLEAN:
            return 0
        costs = [self._cost.get(corruption) for _, corruption, _ in cells]
        known = [(cost, place) for place, cost in enumerate(costs) if cost is not None]
        if has_backlog:
            unknown = [place for place, cost in enumerate(costs) if cost is None]
            if unknown:
                last = cells[unknown[-1]][1]
                return next(place for place in unknown if cells[place][1] == last)
            return max(known, key=lambda entry: (entry[0], -entry[1]))[1]
        return min(known)[1] if known else 0


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
        self.child = Child(predict_forever, model, job.options.measuring.confidence, links)
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
