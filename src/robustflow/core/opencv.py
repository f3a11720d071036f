"""OpenCV with the same results for any number of processors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Run OpenCV in one thread within the block: some of its methods split the image into one stripe per thread, and
    their result depends on the number of stripes.

    >>> import cv2
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
