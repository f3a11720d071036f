"""Everything in this process: for debugging, and for models that live only here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import cv2

from ...psf.threads import blur_threads
from ...runs.plan import Unit
from .base import FinishedUnit, Job, take_seconds


def serial(job: Job, units: Iterable[Unit]) -> Iterator[FinishedUnit]:
    """Compute the units one after the other."""
    worker = job.worker()
    with one_opencv_thread(), blur_threads():
        for unit in units:
            rows = worker.run(unit)
            yield FinishedUnit(unit, rows, take_seconds(worker))


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """OpenCV's methods in one thread, as in every engine; what the caller had set comes back."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
