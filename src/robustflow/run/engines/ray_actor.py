"""The actor that runs on a node: it compares the installed versions, loads the model, and computes units.

Ray imports this module by name on the node. Exceptions of the user's code are returned as results, so an exception from
Ray means that the actor or the node is lost.
"""

from __future__ import annotations

import os
import pickle
import re
import socket
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.environment import keep_freed_memory
from ...core.errors import DataError, RunError, UsageError, options_named
from ...core.version import VERSION

if TYPE_CHECKING:
    from ..computation import FinishedUnit
    from ..plan import Unit
    from ..worker import Worker

Answer = tuple[str, Any]
"""The result of a call: ("done", value), or ("error", (type, message, traceback, culprit))."""

Files = Sequence[tuple[str, int]]
"""Paths and sizes of files, in bytes."""


@dataclass(frozen=True)
class Start:
    """What an actor needs besides the job: the driver's environment, and what must be the same on the node."""

    variables: dict[str, str]
    folder: str
    path: list[str]
    installed: dict[str, str]


def installed() -> dict[str, str]:
    """Return the versions of all software that can affect results: this package (with a hash) and its libraries."""
    from ...core.files import digest_of_bytes
    from ..identity import environment

    package = Path(__file__).parents[2]
    files = {str(path.relative_to(package)): path.read_bytes() for path in sorted(package.rglob("*.py"))}
    code = digest_of_bytes(*(b"%b\0%b" % (name.encode(), content) for name, content in files.items()))
    here = environment()
    return {**here.packages, "robustflow": f"{VERSION} (code {code[:8]})", "python": here.python}


def begin_on_node(variables: dict[str, str], folder: str, path: list[str], wanted: dict[str, str]) -> None:
    """Take over the driver's environment; raise if this node may compute different results."""
    os.environ.update(variables)
    keep_freed_memory()
    if os.path.isdir(folder):
        os.chdir(folder)
    sys.path.extend(each for each in path if each not in sys.path)
    there = installed()
    for name in wanted | there:
        if wanted.get(name) != there.get(name):
            raise RunError(
                f"node {socket.gethostname()}",
                f"has {name} {there.get(name, 'missing')}, but the run was started with {wanted.get(name, 'none')}, "
                "which may affect results; install the same versions on every node",
            )


class Doing:
    """What an actor predicts, under a key in the store of the cluster's head: the driver can read it while the actor
    does not answer, because its model holds the interpreter's lock or its process is stopped."""

    def __init__(self, key: str) -> None:
        self._key = key.encode()
        self._changes = 0

    def write(self, what: str | None) -> None:
        from ray.experimental.internal_kv import _internal_kv_put

        self._changes += 1
        _internal_kv_put(self._key, f"{self._changes} {what or ''}".encode(), overwrite=True)

    def read(self) -> tuple[str, str]:
        """Return a number that differs between predictions, and what is predicted; "" if nothing is."""
        from ray.experimental.internal_kv import _internal_kv_get

        number, _, what = (_internal_kv_get(self._key) or b"").decode().partition(" ")
        return number, what

    def delete(self) -> None:
        from ray.experimental.internal_kv import _internal_kv_del

        _internal_kv_del(self._key)


class UnitActor:
    """A worker on a node. Call `begin` first, then `run` any number of times."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self._node = f"node {socket.gethostname()}"

    def begin(self, job: bytes, start: Start, key: str | None) -> Answer:
        """Load dataset and model, and return the node's name with the model's device; `key` is that of `Doing`."""
        return answered(lambda: self._begin(job, start, key))

    def run(self, unit: Unit, files: Files) -> Answer:
        """Return a unit with its rows; `files` are the files of its sample."""
        return answered(lambda: self._run(unit, files))

    def _begin(self, pickled: bytes, start: Start, key: str | None) -> str:
        begin_on_node(start.variables, start.folder, start.path, start.installed)
        import cv2

        from ..identity import difference
        from ..plan import Job, name_model
        from ..worker import Worker

        cv2.setNumThreads(1)
        try:
            job: Job = pickle.loads(pickled)
        except (ImportError, AttributeError) as error:
            raise UsageError(
                self._node,
                f"cannot import a module of the run ({error}); install it on every node, or put it on PYTHONPATH "
                "before Ray starts there",
            ) from error
        model = name_model(job.model.ref or job.model.model)
        if model.identity != job.model.identity:
            differing = difference(model.identity, job.model.identity)
            why = (
                f"has a different model of the same name (it differs in: {differing}); use the same files on every node"
            )
            raise RunError(self._node, why)
        job = replace(job, folder=None, model=model)
        self._worker = Worker(job) if key is None else Worker(job, Doing(key).write)
        return f"{socket.gethostname()}, {_device()}"

    def _run(self, unit: Unit, files: Files) -> FinishedUnit:
        assert self._worker is not None
        self._check_files(files)
        return self._worker.run(unit)

    def _check_files(self, files: Files) -> None:
        for name, size in files:
            path = os.path.abspath(name)
            try:
                here = os.stat(path).st_size
            except OSError as error:
                raise DataError(
                    self._node,
                    f"{path} cannot be read ({error.strerror}); make the data available on every node under the same "
                    "path, preferably an absolute one",
                ) from error
            if here != size:
                raise DataError(
                    self._node,
                    f"{path} has {here} bytes there but {size} bytes on this machine; use the same data on every node",
                )


def answered(compute: Callable[[], Any]) -> Answer:
    """Return the result or the exception of a call as an `Answer`."""
    try:
        with options_named():  # the driver renames them if it is no command
            return "done", compute()
    except BaseException as error:  # SystemExit too: Ray would assume that the actor ended on purpose
        return failed(error)


def failed(error: BaseException) -> Answer:
    """Return an exception as an `Answer`; its message names the node, unless it does so already."""
    node, message = f"node {socket.gethostname()}", str(error)
    if node not in message:
        message = f"{message} (on {node})"
    trace = "".join(traceback.format_exception(error))
    return "error", (type(error).__name__, message, trace, getattr(error, "culprit", ""))


def cannot_start(error: Exception) -> RunError:
    """Return the error for a node that cannot load this package; the user's code is loaded later."""
    address = re.search(r"\bip=([^,\s)]+)", str(error))
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return RunError(
        f"node {address[1] if address else '(address unknown)'}",
        f"cannot start RobustFlow ({lines[-1]}); install the same version on every node",
    )


def _device() -> str:
    import ray

    gpus = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
    if not gpus:
        return "CPU"
    torch = sys.modules.get("torch")
    named = f" ({torch.cuda.get_device_name(0)})" if torch is not None and torch.cuda.is_available() else ""
    return f"GPU {','.join(gpus)}{named}"
