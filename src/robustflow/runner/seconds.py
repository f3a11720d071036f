"""Seconds spent by kind of work."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

Seconds = dict[str, float]
"""Seconds by kind of work: "load", "corrupt", "attack", "predict", "measure", and of each attack, "attack pgd", which
are part of "attack"."""


def no_seconds() -> Seconds:
    """All counters at zero."""
    return {"load": 0.0, "corrupt": 0.0, "attack": 0.0, "predict": 0.0, "measure": 0.0}


@contextmanager
def timed(seconds: Seconds, kind: str) -> Iterator[None]:
    """Add the time that the block takes."""
    start = time.perf_counter()
    yield
    seconds[kind] = seconds.get(kind, 0.0) + time.perf_counter() - start


def pop_timings(seconds: Seconds) -> Seconds:
    """The seconds spent since the last call; counting starts again at zero.

    >>> seconds = no_seconds()
    >>> seconds["load"] = 2.0
    >>> pop_timings(seconds)["load"], seconds["load"]
    (2.0, 0.0)
    """
    so_far = dict(seconds)
    seconds.clear()
    seconds.update(no_seconds())
    return so_far
