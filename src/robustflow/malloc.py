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
    """Let glibc keep up to half a gigabyte of the memory that this process frees."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    for variable, (setting, value) in _SETTINGS.items():
        if mallopt is not None and variable not in os.environ:
            mallopt(setting, value)
