"""Compute units in this process, or in a pool of worker processes.

On the CPU, every worker has its own copy of the model. On accelerators, one process per device only predicts, and
the workers ("feeders") corrupt frames and measure flows, which they exchange with it through shared memory. Only this
process writes rows, so an orphaned worker can never write to the folder of a resumed run; a process that hangs or
crashes ends the run with a one-line error.
"""

from __future__ import annotations

import multiprocessing
import pickle
import time
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from multiprocessing.connection import Connection, wait
from typing import Any

from ...core.errors import ModelError
from ...core.opencv import one_opencv_thread
from ...core.processes import Child, preload
from ...models.calls import describe_cell
from ..computation import FinishedUnit
from ..plan import NO_MODEL, Job, Unit
from ..worker import UNITS_AHEAD, Worker
from .base import Engine, FinishedUnits, Schedule, crash_of, pickled, unpickled
from .device import BATCHES_PER_FEEDER, SharedBatch, feed_forever, predict_forever

preload("robustflow.run.engines.preloaded")


def serial(job: Job, units: Iterable[Unit]) -> FinishedUnits:
    """Compute the units in this process, which reads ahead in a second thread if there are no attacks. If the model can
    attack pairs in batches, units of the same attack are grouped."""
    worker = Worker(job)
    attacks = job.attacks if worker.batches_attacks else ()
    with one_opencv_thread():
        if not job.attacks:
            yield from worker.run_ahead(units)
            return
        for group in _grouped(units, attacks, job.batch_size):
            yield from worker.run_attack(group) if len(group) > 1 else [worker.run(group[0])]


def _grouped(units: Iterable[Unit], attacks: Container[str], cells: int) -> Iterator[list[Unit]]:
    """Group the units of each attack into groups of at least `cells` cells; every other unit forms its own group, in
    the original order.

    >>> units = [Unit(key, name, (1, 3)) for key in "ab" for name in ("fog", "pgd")]
    >>> [[unit.key for unit in group] for group in _grouped(units, ["pgd"], 4)]
    [['a'], ['b'], ['a', 'b']]
    """
    waiting: dict[str, list[Unit]] = {}
    for unit in units:
        if unit.corruption not in attacks:
            yield [unit]
            continue
        group = waiting.setdefault(unit.corruption, [])
        group.append(unit)
        if sum(len(each.cells) for each in group) >= cells:
            yield waiting.pop(unit.corruption)
    yield from waiting.values()


SERIAL = Engine(lambda units: "serial", serial)


def too_slow(timeout: float, what: str) -> ModelError:
    """Return the error for a model that takes longer than `timeout` seconds on `what`."""
    return ModelError(what, f"the model took longer than {timeout:g} s; fix it, or allow more time with --timeout")


def processes(
    job: Job, units: Iterable[Unit], workers: int, timeout: float | None = None, devices: Sequence[str] = ()
) -> FinishedUnits:
    """Compute the units in `workers` processes, with the model in a separate process for each of the devices, if any;
    `timeout` is the time limit of a single prediction, in seconds."""
    pickled(job)
    schedule, finished = Schedule(units), list[FinishedUnit]()
    with ExitStack() as stack:
        predicting, pool = _started(stack, job, workers, timeout, devices)
        ahead = UNITS_AHEAD + job.batch_size if devices else 1
        while True:
            for done in finished:
                schedule.finished(done.unit)
            for worker in pool:
                worker.give(schedule, ahead, len(pool))
            yield from finished
            busy = {one.child.pipe: one for one in (*predicting, *pool) if one.units or one in predicting}
            if len(busy) == len(predicting):
                return
            ready = wait(list(busy), timeout=0.2 if timeout else None)
            for pipe, process in busy.items():  # before rows are yielded: writing them can take longer than the timeout
                if pipe not in ready:
                    process.check_timeout()
            answers = [process.receive() for pipe, process in busy.items() if pipe in ready]
            finished = [done for done in answers if done is not None]


def compute_units(pipe: Connection) -> None:
    """Compute the units of a job; the main function of a worker process that has the model."""
    worker = Worker(unpickled(pipe.recv()), lambda what: pipe.send(("doing", what)))
    while True:
        pipe.send(("rows", worker.run(pipe.recv())))


def _started(
    stack: ExitStack, job: Job, workers: int, timeout: float | None, devices: Sequence[str]
) -> tuple[list[_EngineProcess], list[_EngineProcess]]:
    """Start a predicting process for each device, and the workers, which are dealt out to the devices in turn."""
    predicting: list[_EngineProcess] = []
    pool: list[_EngineProcess] = []

    def start(kind: list[_EngineProcess], limit: float | None, advice: str, *target: Any) -> None:
        kind.append(_EngineProcess(Child(*target), job.model.label, advice, limit))
        stack.callback(kind[-1].child.end)

    if not devices:
        sent = pickled(job)
        for _ in range(workers):
            start(pool, timeout, "use fewer --workers", compute_units)
            pool[-1].child.send(sent)
        return predicting, pool
    with ExitStack() as shared:  # closed here as soon as the children have it
        pipes = [multiprocessing.Pipe() for _ in range(workers)]
        batches = [[SharedBatch() for _ in range(BATCHES_PER_FEEDER)] for _ in range(workers)]
        for close in [one.close for one in chain(*pipes)] + [one.close for one in chain(*batches)]:
            shared.callback(close)
        for number, device in enumerate(devices):
            links = [(pipes[one][1], batches[one]) for one in range(number, workers, len(devices))]
            model = pickle.dumps(job.model.on(device) if len(devices) > 1 else job.model)
            confidence = job.measuring.confidence
            start(predicting, timeout, "use a smaller --batch-size", predict_forever, model, confidence, links)
        without_model = pickled(replace(job, model=NO_MODEL))
        for (link, _), memory in zip(pipes, batches, strict=True):
            start(pool, None, "use fewer --workers", feed_forever, without_model, link, memory)
    return predicting, pool


class _EngineProcess:
    """A worker or a predicting process, and the units that a worker has not finished."""

    def __init__(self, child: Child, model: str, advice: str, timeout: float | None) -> None:
        self.child = child
        self.units: list[Unit] = []
        self._advice = f"free some, or {advice} (model {model})", crash_of(model)
        self._timeout = timeout
        self._last_key: str | None = None
        self._doing: str | None = None
        """The cells that are being predicted, or, in a feeder, prepared."""
        self._since = 0.0

    def give(self, schedule: Schedule, ahead: int, workers: int) -> None:
        """Give a worker its next units: the fewer are left, the fewer in advance, so that all workers end together."""
        while len(self.units) < ahead and (not self.units or schedule.left >= workers * len(self.units)):
            unit = schedule.take(self._last_key)
            if unit is None:
                return
            self._last_key = unit.key
            self.units.append(unit)
            self.child.send(unit)

    def receive(self) -> FinishedUnit | None:
        """Read one message, and return the unit that it finishes, if any."""
        unfinished = [describe_cell(unit.key, unit.corruption, *unit.severities) for unit in self.units[:1]]
        kind, value = self.child.receive(self._doing or next(iter(unfinished), "idle worker"), *self._advice)
        if kind == "doing":
            self._doing, self._since = value, time.monotonic()
            return None
        done: FinishedUnit = value
        self.units.remove(done.unit)
        return done

    def check_timeout(self) -> None:
        if self._timeout is not None and self._doing is not None and time.monotonic() - self._since > self._timeout:
            raise too_slow(self._timeout, self._doing)
