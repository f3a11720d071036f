"""Start processes that do not import modules from the working folder, which is untrusted."""

from __future__ import annotations

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
