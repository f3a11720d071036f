"""Start processes that do not import modules from the working folder, which is untrusted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable of Python. If it is unset, `python -c`, which starts the children of `multiprocessing` and its
resource tracker, searches the working folder before the standard library."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Start processes within the block without the working folder on their import path.

    >>> with safe_path():
    ...     os.environ[SAFE_PATH]
    '1'
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        resource_tracker.ensure_running()  # otherwise it would start later, without this setting
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
