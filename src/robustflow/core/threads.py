"""Count processors, and restrict OpenCV to one thread: some of its methods split the image into one stripe per thread,
and their result depends on the number of stripes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2


def available_processors() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Run OpenCV in one thread within the block; the caller's setting is restored afterwards.

    >>> with one_opencv_thread():
    ...     cv2.getNumThreads()
    1
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
