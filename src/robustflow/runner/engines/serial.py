"""Compute all units in this process: for debugging, and for models that cannot be sent to other processes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ...runs.plan import Unit
from ...threads import one_opencv_thread
from .base import Engine, FinishedUnit, Job, take_seconds


def serial(job: Job, units: Iterable[Unit]) -> Iterator[FinishedUnit]:
    """Compute the units in sequence."""
    worker = job.worker()
    with one_opencv_thread():
        for unit in units:
            rows = worker.run(unit)
            yield FinishedUnit(unit, rows, take_seconds(worker))


SERIAL = Engine(lambda units: "serial", serial)
"""Return the serial engine."""
