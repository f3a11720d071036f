"""A pool of worker processes, each of which computes all stages of a unit with its own copy of the model.

This engine is for models on the CPU. A model that hangs or crashes ends the run with a one-line error. Only the parent
process writes shards, so an orphaned worker can never write to the folder of a resumed run.
"""

from __future__ import annotations

from collections.abc import Iterable
from multiprocessing.connection import Connection, wait

from ...child import Child
from ...runs.plan import Unit
from ..seconds import pop_timings
from .base import FinishedUnit, FinishedUnits, Job, pickled
from .prediction_timeout import PredictionTimeout
from .schedule import Schedule


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
