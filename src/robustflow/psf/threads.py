"""How many threads a blur may use: one, until the owner of a process allows it more.

A worker of a data loader or of an engine is not the owner. It must start no threads, nor ask a library how many there
are: numba answers by starting its pool, and a pool of OpenMP does not survive a fork.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from ..threads import available_processors

_owner: ContextVar[tuple[int, int]] = ContextVar("robustflow_blur_threads", default=(0, 1))
"""(process, threads): what is allowed in one process is not allowed in those forked from it."""


def allowed_threads() -> int:
    """Threads that a blur in this process may use."""
    process, threads = _owner.get()
    return threads if process == os.getpid() else 1


@contextmanager
def blur_threads(count: int | None = None) -> Iterator[None]:
    """Allow blurs within the block `count` threads; by default one for each processor this process may use.

    >>> with blur_threads(3):
    ...     allowed_threads()
    3
    >>> allowed_threads()
    1
    """
    token = _owner.set((os.getpid(), count or _default_threads()))
    try:
        yield
    finally:
        _owner.reset(token)


def _default_threads() -> int:
    """As many as NUMBA_NUM_THREADS says, else as the process may run on."""
    named = os.environ.get("NUMBA_NUM_THREADS", "")
    if named.isdecimal() and int(named) > 0:
        return int(named)
    return available_processors()
