"""One thread for OpenCV: some of its methods compute in stripes, one a thread, and answer differently with their
number."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """OpenCV in one thread within the block; what the caller had set comes back.

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
