"""A pool of worker processes that can be watched: a model that hangs or crashes ends the run with a sentence.

Each worker has one pipe of its own. When this process dies, however it dies, the pipe closes and the worker ends;
only this process writes shards, so an orphan can never write into a folder that a resumed run holds.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from ... import errors
from ...errors import ModelError, RobustFlowError, RunError, UsageError
from ...models import ModelSpec
from ...runs.plan import Unit
from .base import FinishedUnit, Job, take_seconds
from .schedule import Schedule

_ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_UNGUARDED = (
    'a script that several workers run needs its own code under `if __name__ == "__main__":`, because each of them '
    "loads the script from the top"
)


def processes(job: Job, units: Iterable[Unit], workers: int, timeout: float | None = None) -> Iterator[FinishedUnit]:
    """Compute the units in `workers` processes; `timeout` is the longest a single prediction may take, in seconds."""
    _check_picklable(job)
    pool: list[_Process] = []
    schedule = Schedule(units)
    try:
        for _ in range(workers):
            pool.append(_Process(job))
        for process in pool:
            process.give(schedule)
        while any(process.unit for process in pool):
            ready = wait([process.pipe for process in pool if process.unit], timeout=0.2 if timeout else None)
            for process in pool:
                if process.pipe in ready:
                    done = process.receive()
                    if done is None:
                        continue
                    schedule.finished(done.unit)
                    for idle in pool:
                        if idle.unit is None:
                            idle.give(schedule)
                    yield done
                elif timeout is not None:
                    process.check(timeout)
    finally:
        for process in pool:
            process.end()


def refuse_unguarded_script() -> None:
    """Raise where a worker process, as it starts, runs the script that started it from the top again.

    Raises:
        UsageError: it does, as Python does with every script without an `if __name__ == "__main__":`.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise UsageError(_UNGUARDED)


class _Process:
    """One worker process and what it is doing."""

    def __init__(self, job: Job) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.unit: Unit | None = None
        self._last_key: str | None = None
        self._predicting: tuple[str, float] | None = None
        self._began = False
        self._process = context.Process(target=_serve, args=(theirs, job), daemon=True)
        with _one_thread(), _no_interrupt():
            self._process.start()
        theirs.close()

    def give(self, schedule: Schedule) -> None:
        """Hand the process its next unit, if there is one."""
        self.unit = schedule.take(self._last_key)
        if self.unit is not None:
            self._last_key = self.unit.key
            self.pipe.send(self.unit)

    def receive(self) -> FinishedUnit | None:
        """Take one message; a finished unit, or None for news about its progress."""
        try:
            kind, value = self.pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join(5)
            code = self._process.exitcode
            if not self._began and code == 1:
                raise RunError(f"a worker process failed to start; the usual cause: {_UNGUARDED}") from None
            raise RunError(
                f"a worker process ended without a message (exit code {code}) while it computed "
                f"{self._what()}; out of memory or a crash inside the model are the usual causes: try fewer --workers"
            ) from None
        self._began = True
        if kind == "predicting":
            self._predicting = (value, time.monotonic()) if value else None
            return None
        if kind == "error":
            raise _rebuild(*value)
        rows, seconds = value
        assert self.unit is not None
        done, self.unit = FinishedUnit(self.unit, rows, seconds), None
        return done

    def check(self, timeout: float) -> None:
        """End the run when a prediction takes too long."""
        if self._predicting and time.monotonic() - self._predicting[1] > timeout:
            raise ModelError(
                f"the model took longer than {timeout:g} s on {self._predicting[0]}; "
                "fix it, or allow it more time with --timeout"
            )

    def end(self) -> None:
        """Stop the process now; whatever it was computing is lost, whatever it finished is on disk."""
        self.pipe.close()
        self._process.terminate()
        self._process.join(2)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _what(self) -> str:
        return f"sample '{self.unit.key}', {self.unit.corruption}" if self.unit else "nothing"


@contextmanager
def _one_thread() -> Iterator[None]:
    """The environment in which a process begins whose libraries compute in one thread each."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Ctrl-C waits here until a process has started, which inherits being deaf to it."""
    resource_tracker.ensure_running()  # started with the first process, it would let Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(pipe: Connection, job: Job) -> None:
    """The life of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    warnings.formatwarning = errors.plain_warning
    import cv2

    cv2.setNumThreads(1)
    try:
        worker = job.worker(lambda what: pipe.send(("predicting", what)))
        while True:
            unit = pipe.recv()
            rows = worker.run(unit)
            pipe.send(("rows", (rows, take_seconds(worker))))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except BaseException as error:
        try:
            pipe.send(("error", (type(error).__name__, str(error), traceback.format_exc())))
        except OSError:
            return


def _rebuild(kind: str, message: str, trace: str) -> Exception:
    """The worker's exception, with its traceback as the cause."""
    known: Any = getattr(errors, kind, None)
    if isinstance(known, type) and issubclass(known, RobustFlowError):
        error: Exception = known(message)
    else:
        error = RuntimeError(f"{kind} in a worker process: {message}\n{trace}")
    error.__cause__ = RuntimeError(f"in a worker process:\n{trace}")
    return error


def _check_picklable(job: Job) -> None:
    if isinstance(job.model, ModelSpec):
        return
    try:
        pickle.dumps(job.model)
    except Exception as error:
        raise UsageError(
            f"this model object cannot be sent to worker processes ({type(error).__name__}: {error}); use "
            "engine='serial' without a timeout, or name the model as 'module:attribute'"
        ) from error
