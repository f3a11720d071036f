"""Measure the time spent on each kind of work."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

Seconds = dict[str, float]
"""Seconds by kind of work: "load", "corrupt", "attack", "predict", "measure", and one entry per attack, such as "attack
pgd", whose time is included in "attack"."""


def no_seconds() -> Seconds:
    """Return all counters, set to zero."""
    return {"load": 0.0, "corrupt": 0.0, "attack": 0.0, "predict": 0.0, "measure": 0.0}


@contextmanager
def timed(seconds: Seconds, kind: str) -> Iterator[None]:
    """Add the duration of the block."""
    start = time.perf_counter()
    yield
    seconds[kind] = seconds.get(kind, 0.0) + time.perf_counter() - start


def pop_timings(seconds: Seconds) -> Seconds:
    """Return the seconds spent since the last call, and reset all counters.

    >>> seconds = no_seconds()
    >>> seconds["load"] = 2.0
    >>> pop_timings(seconds)["load"], seconds["load"]
    (2.0, 0.0)
    """
    so_far = dict(seconds)
    seconds.clear()
    seconds.update(no_seconds())
    return so_far
