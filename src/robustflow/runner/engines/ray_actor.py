"""What runs on a node: it reports what is installed there, loads the model, and computes units.

Ray loads this file on the node by its name. Whatever the user's code raises comes back as an answer, so an exception
from Ray means that the actor or the node is lost.
"""

from __future__ import annotations

import os
import pickle
import secrets
import shutil
import socket
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import DataError, RunError, UsageError
from ...version import VERSION
from .malloc import keep_freed_memory

if TYPE_CHECKING:
    from ...runs.plan import Unit
    from ..worker import Worker

Answer = tuple[str, Any]
"""("done", value), or ("error", (type, message, traceback))."""

Files = Sequence[tuple[str, int]]
"""Paths and sizes of files."""


def installed() -> dict[str, str]:
    """Version by name of everything installed that can change a number: this package with a hash of its code, and the
    libraries it uses."""
    from ...digest import digest_of_bytes
    from ...runs.environment import environment

    package = Path(__file__).parents[2]
    paths = sorted(path for path in package.rglob("*.py"))
    code = digest_of_bytes(
        *(b"%b\0%b" % (str(path.relative_to(package)).encode(), path.read_bytes()) for path in paths)
    )
    here = environment()
    return {"robustflow": f"{VERSION} (code {code[:8]})", "python": here.python} | {
        name: version for name, version in here.packages.items() if name != "robustflow"
    }


def check_installed(host: str, here: dict[str, str], there: dict[str, str]) -> None:
    """Raise if a node may compute different numbers.

    Args:
        host: the node's name.
        here, there: what `installed` returns where the run was started, and on the node.

    Raises:
        RunError: they differ.
    """
    for name in here | there:
        if here.get(name) != there.get(name):
            raise RunError(
                f"node {host} has {name} {there.get(name, 'missing')} where the run was started with "
                f"{here.get(name, 'none')}, which may change numbers; install the same versions on every node"
            )


class UnitActor:
    """One worker on a node. Its methods are called in this order: `hello`, `begin`, then `run` any number of times."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self._predicting: tuple[str, float] | None = None
        self._host = socket.gethostname()
        self._scratch = Path(tempfile.gettempdir()) / f"robustflow-{secrets.token_hex(8)}"

    def hello(self, variables: dict[str, str], folder: str, path: list[str]) -> tuple[str, dict[str, str]]:
        """The node's name and what is installed there.

        Args:
            variables: environment variables, set before anything that reads them is loaded.
            folder: the driver's working folder, which relative paths refer to.
            path: folders of modules, in addition to the node's own.
        """
        os.environ.update(variables)
        keep_freed_memory()
        if os.path.isdir(folder):
            os.chdir(folder)
        sys.path.extend(each for each in path if each not in sys.path)
        return self._host, installed()

    def begin(self, pickled: bytes, identity: dict[str, Any], files: Files) -> Answer:
        """Load data set and model, and return the device it computes on.

        Args:
            pickled: a `Job`.
            identity: the expected identity of the model.
            files: of one sample, which have to exist on the node.
        """
        return answered(lambda: self._begin(pickled, identity, files))

    def run(self, unit: Unit, files: Files) -> Answer:
        """The rows of a unit and the seconds they took; `files` are those of its sample."""
        return answered(lambda: self._run(unit, files))

    def predicting(self) -> tuple[str, float] | None:
        """What the model is predicting at this moment, and for how many seconds already."""
        now = self._predicting
        return now and (now[0], time.monotonic() - now[1])

    def _begin(self, pickled: bytes, identity: dict[str, Any], files: Files) -> str:
        import cv2

        from ...models import ModelSpec
        from ...models.base import model_identity
        from ...runs.identity import differing_fields
        from .base import Job

        cv2.setNumThreads(1)
        try:
            job: Job = pickle.loads(pickled)
        except (ImportError, AttributeError) as error:
            raise UsageError(
                f"node {self._host} cannot import what the run uses ({error}); install it on every node, or put it on "
                "PYTHONPATH before Ray starts there"
            ) from error
        self._check_files(files)
        model = job.load_model()
        loaded = job.model.identity(model) if isinstance(job.model, ModelSpec) else model_identity(model)
        if loaded != identity:
            raise RunError(
                f"node {self._host} has another model under the same name (it differs in: "
                f"{differing_fields(loaded, identity)}); give every node the same files"
            )
        self._worker = replace(job, folder=self._scratch, loaded=model).worker(self._note)
        return _device()

    def _run(self, unit: Unit, files: Files) -> tuple[list[dict[str, Any]], dict[str, float]]:
        from ...runs.store import RunFolder
        from .base import take_seconds

        assert self._worker is not None
        self._check_files(files)
        RunFolder(self._scratch).clean_path(unit.key).parent.mkdir(parents=True)
        try:
            rows = self._worker.run(unit)
        finally:
            shutil.rmtree(self._scratch)  # the worker has the clean flow of its sample in memory
        return rows, take_seconds(self._worker)

    def _note(self, what: str | None) -> None:
        self._predicting = None if what is None else (what, time.monotonic())

    def _check_files(self, files: Files) -> None:
        for path, size in files:
            try:
                here = os.stat(path).st_size
            except OSError as error:
                raise DataError(
                    f"node {self._host}: {os.path.abspath(path)} cannot be read ({error.strerror}); give every node "
                    "the data under the same path, preferably an absolute one"
                ) from error
            if here != size:
                raise DataError(
                    f"node {self._host}: {os.path.abspath(path)} has {here} bytes there and {size} here; give every "
                    "node the same data"
                )


def answered(compute: Callable[[], Any]) -> Answer:
    """What a call returns or raises, as an answer."""
    try:
        return "done", compute()
    except BaseException as error:  # SystemExit as well: Ray would regard it as an actor that ends on purpose
        return "error", (type(error).__name__, str(error), traceback.format_exc())


def _device() -> str:
    """The device that Ray gave this actor."""
    import ray

    given = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
    if not given:
        return "CPU"
    torch = sys.modules.get("torch")
    named = f" ({torch.cuda.get_device_name(0)})" if torch is not None and torch.cuda.is_available() else ""
    return f"GPU {','.join(given)}{named}"
