"""Let a worker process keep freed memory for its next cell."""

from __future__ import annotations

import ctypes
import os

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt(3)."""

_SETTINGS = {
    "MALLOC_TRIM_THRESHOLD_": (_TRIM_THRESHOLD, 512 * 2**20),
    "MALLOC_MMAP_THRESHOLD_": (_MMAP_THRESHOLD, 32 * 2**20),
}


def keep_freed_memory() -> None:
    """Let glibc keep the memory that this process frees, up to half a gigabyte.

    Otherwise it returns every freed frame and flow to the system and gets them back page by page: 2 ms for each
    prediction at KITTI's size, for which a GPU may take 10. MALLOC_ variables set by the user take precedence; with
    another C library nothing happens.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    for variable, (setting, value) in _SETTINGS.items():
        if mallopt is not None and variable not in os.environ:
            mallopt(setting, value)
