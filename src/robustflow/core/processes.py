"""A child process that can be monitored, and that exits when its parent does.

Each child has a pipe for messages (kind, value). When the parent dies for any reason, a second pipe closes, which ends
the child, even if it hangs inside a model.

On Linux, children are forked from one process (the fork server of `multiprocessing`) that has imported the modules they
need and runs nothing else, so that only one process pays for the imports.
"""

from __future__ import annotations

import errno
import fcntl
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from typing import Any, TypeVar

from . import errors
from .display import ignore_local_settings
from .environment import ONE_THREAD, environment_variables, keep_freed_memory, safe_path
from .errors import RobustFlowError, RunError, UsageError
from .files import scratch_folder
from .user_script import UNGUARDED, user_script, without_user_script

T = TypeVar("T")

_preloaded: list[str] = []


def preload(*modules: str) -> None:
    """Let the process from which children are forked import these modules when it starts. Their threads, if any, must
    survive a fork."""
    _preloaded.extend(modules)


_starting = threading.Lock()
"""Held while a child starts, because all threads share one environment."""


class Child:
    """One child process."""

    def __init__(
        self,
        target: Callable[..., None],
        *arguments: Any,
        runs_script: bool = True,
        ignored: Sequence[signal.Signals] = (signal.SIGINT,),
    ) -> None:
        if multiprocessing.current_process().daemon:
            raise UsageError(
                "a daemonic process, such as a worker of multiprocessing.Pool, cannot start a process; use "
                "concurrent.futures.ProcessPoolExecutor instead"
            )
        self.pipe, child_end = multiprocessing.Pipe()
        watched, self._lifeline = multiprocessing.Pipe(duplex=False)
        self._began = False
        script = nullcontext() if runs_script and user_script() else without_user_script()
        with _starting, environment_variables(ONE_THREAD), safe_path(), _blocking_stop_signals(), script:
            given = (dict(os.environ), ignored, child_end, watched, target, arguments)
            # not a daemon, which could not have a child itself; the finalizer ends it before this process waits for it
            self._process = _context().Process(target=child_main, args=given, daemon=False)
            try:
                self._process.start()
            except (EOFError, ConnectionError) as error:
                raise RunError(
                    "a worker process failed to start: the process that forks workers has ended; the usual cause is "
                    "lack of memory: try fewer --workers"
                ) from error
            self.end = Finalize(self, _end, (self._process, self.pipe, self._lifeline), exitpriority=10)
            """Stop the process immediately."""
        child_end.close()
        watched.close()

    def send(self, message: Any) -> None:
        """Send a message; if the child has ended, `receive` reports it."""
        with suppress(BrokenPipeError, ConnectionError):
            self.pipe.send(message)

    def receive(self, doing: str, if_killed: str, if_crashed: str) -> tuple[str, Any]:
        """Return the next message. If the child has ended, raise an error with one of the two pieces of advice: a
        process without enough memory is killed."""
        try:
            kind, value = self.pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join(5)
            code = self._process.exitcode
            if not self._began and code == 1:
                raise RunError(f"a worker process failed to start; a guard may be missing: {UNGUARDED}") from None
            if code == -signal.SIGKILL:
                raise RunError(doing, f"its process was killed, usually for lack of memory: {if_killed}") from None
            how = f"exit code {code}" if code is None or code >= 0 else signal.Signals(-code).name
            raise RunError(doing, f"its process crashed ({how}): {if_crashed}") from None
        self._began = True
        if kind == "error":
            raise rebuilt(*value)
        return kind, value


def in_child(doing: str, steps: Callable[..., Iterator[T]], *arguments: Any) -> Iterator[T]:
    """Start a child that runs a generator function, and return an iterator over what it yields; `doing` names what it
    does in errors."""
    child = Child(_send_steps, steps, arguments)

    def received() -> Iterator[T]:
        try:
            while (message := child.receive(doing, "free some memory", "a library failed in native code"))[0] == "step":
                yield message[1]
        finally:
            child.end()

    return received()


def _send_steps(pipe: Connection, steps: Callable[..., Iterator[Any]], arguments: tuple[Any, ...]) -> None:
    for step in steps(*arguments):
        pipe.send(("step", step))
    pipe.send(("end", None))


_LONGEST_TMP = 107 - len("/rf-01234567/pymp-01234567/listener-01234567")
"""Longest temporary folder whose sockets have names that Linux allows, in bytes."""
_server_environment: dict[str, str] = {}
"""The environment in which the process that forks children was started."""


def forks_children() -> bool:
    """Return whether the process that forks children has started, so that another child costs little."""
    return bool(_server_environment)


def _context() -> ForkServerContext | SpawnContext:
    """Return how to start a child: from the process that forks children, unless there can be none, or the environment
    has changed since, which modules may read while they are imported."""
    if sys.platform == "linux":
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(_preloaded)
        now = dict(os.environ)
        search = os.pathsep.join(path or os.getcwd() for path in sys.path)
        # no socket can have a long path, and a forked process cannot use the server of its parent
        with suppress(OSError), environment_variables({"PYTHONPATH": search}):
            if not _server_environment:
                _start_server()
                _server_environment.update(now)
            if now == _server_environment:
                forkserver.ensure_running()
                return context
    return multiprocessing.get_context("spawn")


def _start_server() -> None:
    """Start the process that forks children, with its socket in a folder that outlives this process only until the next
    command."""
    scratch, usual = ExitStack(), tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > _LONGEST_TMP:
        raise OSError(errno.ENAMETOOLONG, "too long for a socket", tempfile.gettempdir())
    Finalize(None, scratch.close, exitpriority=-101)  # after that of `multiprocessing`, which removes the socket
    tempfile.tempdir = scratch.enter_context(scratch_folder(tempfile.gettempdir()))
    try:
        forkserver.ensure_running()
    finally:
        tempfile.tempdir = usual


def _end(process: BaseProcess, pipe: Connection, lifeline: Connection) -> None:
    pipe.close()
    process.kill()
    process.join()
    lifeline.close()


STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that a terminal or a scheduler sends to every process of a command."""


@contextmanager
def _blocking_stop_signals() -> Iterator[None]:
    """Block stop signals while a process starts, so that the process inherits the setting. The resource tracker must
    already be running, because starting it would unblock them."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    # any other thread of this process may still receive a signal, and the main thread would then raise
    received: list[int] = []
    in_charge = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS if in_charge}
    replaced = {number: handler for number, handler in handlers.items() if callable(handler)}
    for stop in replaced:
        signal.signal(stop, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        for stop, handler in replaced.items():
            signal.signal(stop, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    for number in received[:1]:
        replaced[signal.Signals(number)](number, None)


def child_main(
    environment: dict[str, str],
    ignored: Sequence[signal.Signals],
    pipe: Connection,
    watched: Connection,
    target: Callable[..., None],
    arguments: tuple[Any, ...],
) -> None:
    """Run `target` in the child, and send any exception to the parent."""
    os.environ.clear()  # a fork server keeps the environment with which it was started
    os.environ.update(environment)
    ignore_local_settings()
    for stop in ignored:
        signal.signal(stop, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)
    _end_with_parent(watched)
    keep_freed_memory()
    warnings.formatwarning = errors.plain_warning
    import cv2

    cv2.setNumThreads(1)
    try:
        with errors.options_named():  # the parent renames them if it is no command
            target(pipe, *arguments)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except BaseException as error:
        try:
            culprit = getattr(error, "culprit", "")
            pipe.send(("error", (type(error).__name__, str(error), traceback.format_exc(), culprit)))
        except OSError:
            return


def _end_with_parent(watched: Connection) -> None:
    """Let this process end when the other end of a pipe is closed, even while it is stopped (SIGSTOP) or a model holds
    the interpreter's lock: Linux then sends SIGKILL."""
    if sys.platform == "linux":
        fcntl.fcntl(watched, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(watched, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(watched, fcntl.F_SETFL, fcntl.fcntl(watched, fcntl.F_GETFL) | os.O_ASYNC)
    threading.Thread(target=_exit_when_closed, args=(watched,), daemon=True).start()  # it may be closed already


def _exit_when_closed(watched: Connection) -> None:
    try:
        watched.recv_bytes()  # nothing is ever sent through this pipe
    except (EOFError, OSError):
        os._exit(1)


def rebuilt(kind: str, message: str, trace: str, culprit: str = "") -> Exception:
    """Return a child's exception with its traceback as the cause."""
    raised: Any = getattr(errors, kind, None)
    if isinstance(raised, type) and issubclass(raised, RobustFlowError):
        error: Exception = raised(message)
        vars(error)["culprit"] = errors.as_argument(culprit)
    else:
        error = RuntimeError(f"{kind} in a worker process: {message}\n{trace}")
    error.__cause__ = RuntimeError(f"in a worker process:\n{trace}")
    return error
