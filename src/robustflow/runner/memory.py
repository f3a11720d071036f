"""Name the cell for which there was not enough memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from ..errors import RunError, first_line


@contextmanager
def memory_errors_named(doing: str) -> Iterator[None]:
    """Within the block, convert NumPy's and OpenCV's errors about lack of memory."""
    try:
        yield
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and getattr(error, "code", None) != cv2.Error.StsNoMem:
            raise
        raise RunError(
            f"not enough memory to compute {doing} ({first_line(error)}); try fewer --workers, a smaller --batch-size "
            "or smaller frames"
        ) from error
