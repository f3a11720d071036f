"""Settings of the processes that a run starts: environment variables, threads, import path, and memory."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import resource_tracker

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable of Python. If it is unset, `python -c`, which starts the children of `multiprocessing` and its
resource tracker, searches the working folder before the standard library."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Start processes within the block without the working folder on their import path."""
    with environment_variables({SAFE_PATH: "1"}):
        resource_tracker.ensure_running()  # otherwise it would start later, without this setting
        yield


@contextmanager
def environment_variables(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within the block, for the processes started in it."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "POLARS_MAX_THREADS")
ONE_THREAD = dict.fromkeys(_THREADS, "1")
"""Environment variables with which each library in a new process uses one thread."""

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
