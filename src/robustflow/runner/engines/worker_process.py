"""A process that computes units, started early and kept for longer than a run where a command asks for it.

The imports of such a process take as long as those of the command that starts it: started first, both import at the
same time. So this file imports little. After a run the next one can have it, or an errand: something that has to be
done for the run and needs nothing of this process.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from ...threads import available_processors
from .child import Child

if TYPE_CHECKING:
    from .base import Job

MOST_PROCESSES = 8
"""Most processes started unasked: each takes 300 MB and more."""

_OWN = "ROBUSTFLOW_"
"""How the package's environment variables begin."""

Done = TypeVar("Done")


class _Surroundings(NamedTuple):
    """What this process has been told since the other one started: where the user's files and modules are."""

    variables: dict[str, str]
    path: list[str]


class _Errand(NamedTuple):
    """A function of a module, and what to call it with."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


_idle: list[Child] | None = None
"""Processes without work, within `kept_processes`."""

_kept: list[Child] = []
"""All processes that end with that block."""


@contextmanager
def kept_processes(early: bool) -> Iterator[None]:
    """Within the block, processes are kept after their runs; with `early` as many as a light model uses by default are
    started at once."""
    global _idle
    count = min(available_processors(), MOST_PROCESSES) if early else 0
    _idle = []
    try:
        for _ in range(count if count > 1 else 0):
            release(Child(_serve), idle=True)
        yield
    finally:
        _idle = None
        while _kept:
            _kept.pop().end()


def worker_process(job: Job) -> Child:
    """A process that takes units of a job and sends ("rows", (rows, seconds)) for each, and before that ("predicting",
    what) and ("predicting", None) for each prediction."""
    child = _idle.pop(0) if _idle else Child(_serve)
    child.send(_surroundings())
    child.send(job)
    return child


def release(child: Child, idle: bool) -> None:
    """Let a worker process go; `idle` says that it has sent the rows of every unit that it was given."""
    if idle and _idle is not None:
        _idle.append(child)
        if child not in _kept:
            _kept.append(child)
    else:
        child.end()


def errand(function: Callable[..., Done], *arguments: Any) -> Callable[[], Done]:
    """Call a function in an idle process, if there is one, while this process continues; returns how to get its result.

    Without one, or if it fails there, the function is called here when its result is asked for.

    >>> errand(max, 1, 2)()
    2
    """
    if not _idle:
        return lambda: function(*arguments)
    child = _idle.pop()
    child.send(_surroundings())
    child.send(_Errand(function, arguments))

    def result() -> Done:
        try:
            done: Done = child.receive("an errand", "")[1]
        except Exception:
            child.end()
            return function(*arguments)
        release(child, idle=True)
        return done

    return result


def _surroundings() -> _Surroundings:
    return _Surroundings({name: os.environ[name] for name in os.environ if name.startswith(_OWN)}, list(sys.path))


def _adopt(there: _Surroundings) -> None:
    for name in [name for name in os.environ if name.startswith(_OWN)]:
        del os.environ[name]
    os.environ.update(there.variables)
    sys.path[:] = there.path


def _serve(pipe: Connection) -> None:
    from ...runs.plan import Unit
    from .base import Job, take_seconds  # imports everything that a unit needs, before there is a job

    worker = None
    while True:
        message: _Surroundings | Job | Unit | _Errand = pipe.recv()
        if isinstance(message, _Surroundings):
            _adopt(message)
        elif isinstance(message, Job):
            worker = message.worker(lambda what: pipe.send(("predicting", what)))
        elif isinstance(message, Unit):
            assert worker is not None
            rows = worker.run(message)
            pipe.send(("rows", (rows, take_seconds(worker))))
        else:
            pipe.send(("done", message.function(*message.arguments)))
