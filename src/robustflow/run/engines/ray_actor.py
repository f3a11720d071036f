"""The actor that runs on a node: it reports the installed versions, loads the model, and computes units.

Ray imports this module by name on the node. Exceptions of the user's code are returned as results, so an exception from
Ray means that the actor or the node is lost.
"""

from __future__ import annotations

import os
import pickle
import re
import socket
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import DataError, RunError, UsageError
from ...core.processes import keep_freed_memory
from ...core.version import VERSION

if TYPE_CHECKING:
    from ..plan import Unit
    from ..worker import Worker

Answer = tuple[str, Any]
"""The result of a call: ("done", value), or ("error", (type, message, traceback, culprit))."""

Files = Sequence[tuple[str, int]]
"""Paths and sizes of files, in bytes."""


def installed() -> dict[str, str]:
    """Return the versions of all software that can affect results: this package (with a hash) and its libraries."""
    from ...core.files import digest_of_bytes
    from ..identity import environment

    package = Path(__file__).parents[2]
    files = {str(path.relative_to(package)): path.read_bytes() for path in sorted(package.rglob("*.py"))}
    code = digest_of_bytes(*(b"%b\0%b" % (name.encode(), content) for name, content in files.items()))
    here = environment()
    return {**here.packages, "robustflow": f"{VERSION} (code {code[:8]})", "python": here.python}


def check_installed(host: str, here: dict[str, str], there: dict[str, str]) -> None:
    """Raise if a node may compute different results."""
    for name in here | there:
        if here.get(name) != there.get(name):
            raise RunError(
                f"node {host}",
                f"has {name} {there.get(name, 'missing')}, but the run was started with {here.get(name, 'none')}, "
                "which may affect results; install the same versions on every node",
            )


class UnitActor:
    """A worker on a node. Call `hello` first, then `begin`, then `run` any number of times."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self._predicting: tuple[str, float] | None = None
        self._node = f"node {socket.gethostname()}"

    def hello(self, variables: dict[str, str], folder: str, path: list[str]) -> tuple[str, dict[str, str]]:
        """Return the node's name and the versions installed there."""
        os.environ.update(variables)
        keep_freed_memory()
        if os.path.isdir(folder):
            os.chdir(folder)
        sys.path.extend(each for each in path if each not in sys.path)
        return socket.gethostname(), installed()

    def begin(self, pickled: bytes, identity: dict[str, Any], files: Files) -> Answer:
        """Load dataset and model, and return the model's device."""
        return answered(lambda: self._begin(pickled, identity, files))

    def run(self, unit: Unit, files: Files) -> Answer:
        """Return the rows of a unit and the time they took, in seconds; `files` are the files of its sample."""
        return answered(lambda: self._run(unit, files))

    def predicting(self) -> tuple[str, float] | None:
        """Return a description of the current prediction, and its duration so far in seconds."""
        now = self._predicting
        return now and (now[0], time.monotonic() - now[1])

    def _begin(self, pickled: bytes, identity: dict[str, Any], files: Files) -> str:
        import cv2

        from ..identity import difference
        from .base import Job

        cv2.setNumThreads(1)
        try:
            job: Job = pickle.loads(pickled)
        except (ImportError, AttributeError) as error:
            raise UsageError(
                self._node,
                f"cannot import a module of the run ({error}); install it on every node, or put it on PYTHONPATH "
                "before Ray starts there",
            ) from error
        self._check_files(files)
        model = job.load_model()
        if (loaded := job.model_identity(model)) != identity:
            raise RunError(
                self._node,
                f"has a different model of the same name (it differs in: {difference(loaded, identity)}); use "
                "the same files on every node",
            )
        self._worker = replace(job, folder=None, loaded=model).worker(self._note)
        return _device()

    def _run(self, unit: Unit, files: Files) -> tuple[list[dict[str, Any]], dict[str, float]]:
        from ..stages import pop_timings

        assert self._worker is not None
        self._check_files(files)
        return self._worker.run(unit), pop_timings(self._worker.seconds)

    def _note(self, what: str | None) -> None:
        self._predicting = None if what is None else (what, time.monotonic())

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
        return "done", compute()
    except BaseException as error:  # SystemExit too: Ray would assume that the actor ended on purpose
        return "error", (type(error).__name__, str(error), traceback.format_exc(), getattr(error, "culprit", ""))


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
