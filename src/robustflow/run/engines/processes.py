"""Compute all units in this process: for debugging, and for models that cannot be sent to other processes. Limit
the duration of a prediction. A pool of worker processes, each of which computes all stages of a unit with its
own copy of the model.

This engine is for models on the CPU. A model that hangs or crashes ends the run with a one-line error. Only the parent
process writes shards, so an orphaned worker can never write to the folder of a resumed run.
"""

from __future__ import annotations

import time
from collections.abc import Container, Iterable, Iterator
from multiprocessing.connection import Connection, wait

from ...core.errors import ModelError
from ...core.processes import Child, one_opencv_thread
from ..plan import Unit
from ..seconds import pop_timings
from .base import Engine, FinishedUnit, FinishedUnits, Job, Schedule, pickled


def serial(job: Job, units: Iterable[Unit]) -> FinishedUnits:
    """Compute the units in sequence; if the model can attack pairs in batches, units of the same attack are grouped."""
    worker = job.worker()
    attacks = job.options.attacks if worker.batches_attacks else ()
    with one_opencv_thread():
        for group in _grouped(units, attacks, job.batch_size):
            rows = worker.run_attack(group) if len(group) > 1 else [worker.run(group[0])]
            for unit, of_unit in zip(group, rows, strict=True):
                yield FinishedUnit(unit, of_unit, pop_timings(worker.seconds))


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


class PredictionTimeout:
    """Monitor the predictions of one process."""

    def __init__(self, timeout: float | None) -> None:
        self._timeout = timeout
        self._since = 0.0
        self.what: str | None = None
        """Description of the current prediction."""

    def note(self, what: str | None) -> None:
        """Record the start of a prediction, or its end if `what` is None."""
        self.what, self._since = what, time.monotonic()

    def check(self) -> None:
        """Check the duration of the current prediction."""
        if self._timeout is not None and self.what is not None and time.monotonic() - self._since > self._timeout:
            raise too_slow(self._timeout, self.what)


def too_slow(timeout: float, what: str) -> ModelError:
    """Return the error for a model that takes longer than `timeout` seconds on `what`."""
    return ModelError(f"the model took longer than {timeout:g} s on {what}; fix it, or allow more time with --timeout")


def processes(job: Job, units: Iterable[Unit], workers: int, timeout: float | None = None) -> FinishedUnits:
    """Compute the units in `workers` processes; `timeout` is the time limit of a single prediction, in seconds."""
    pickled(job)
    pool: list[_WorkerHandle] = []
    schedule = Schedule(units)
    try:
        for _ in range(workers):
            pool.append(_WorkerHandle(job, timeout))
        for process in pool:
            process.give(schedule)
        while any(process.unit for process in pool):
            ready = wait([process.child.pipe for process in pool if process.unit], timeout=0.2 if timeout else None)
            for process in pool:  # before rows are yielded, because writing them can take longer than the timeout
                if process.child.pipe not in ready:
                    process.timeout.check()
            for process in pool:
                if process.child.pipe in ready:
                    done = process.receive()
                    if done is None:
                        continue
                    schedule.finished(done.unit)
                    for idle in pool:
                        if idle.unit is None:
                            idle.give(schedule)
                    yield done
    finally:
        for process in pool:
            process.child.end()


def compute_units(pipe: Connection) -> None:
    """Compute the units of a job; the main function of a worker process."""
    worker = pipe.recv().worker(lambda what: pipe.send(("predicting", what)))
    while True:
        rows = worker.run(pipe.recv())
        pipe.send(("rows", (rows, pop_timings(worker.seconds))))


class _WorkerHandle:
    """One worker process and its current work."""

    def __init__(self, job: Job, timeout: float | None) -> None:
        self.child = Child(compute_units)
        self.child.send(job)
        self.unit: Unit | None = None
        self.timeout = PredictionTimeout(timeout)
        self._last_key: str | None = None

    def give(self, schedule: Schedule) -> None:
        """Give the process its next unit, if there is one."""
        self.unit = schedule.take(self._last_key)
        if self.unit is not None:
            self._last_key = self.unit.key
            self.child.send(self.unit)

    def receive(self) -> FinishedUnit | None:
        """Read one message, and return a finished unit, or None for a progress message."""
        doing = f"sample '{self.unit.key}', {self.unit.corruption}" if self.unit else "nothing"
        kind, value = self.child.receive(doing, "try fewer --workers")
        if kind == "predicting":
            self.timeout.note(value)
            return None
        rows, seconds = value
        assert self.unit is not None
        done, self.unit = FinishedUnit(self.unit, rows, seconds), None
        return done
