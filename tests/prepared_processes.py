"""Start worker processes quickly, by forking them from one process that has already imported the package.

A run starts its workers with the method "spawn", and each imports the package, which takes more than a second. The
processes made here are separate in the same way: they load the model and the data themselves and can be killed.
"""

import multiprocessing
import os
from multiprocessing import forkserver
from multiprocessing.context import BaseContext, ForkServerContext, ForkServerProcess
from pathlib import Path

import pytest


class _Process(ForkServerProcess):
    """Has the environment variables of its parent at the time of `start`, as with "spawn"."""

    def start(self) -> None:
        self._environment = dict(os.environ)
        super().start()

    def run(self) -> None:
        os.environ.clear()
        os.environ.update(self._environment)
        super().run()


class _Context(ForkServerContext):
    Process = _Process


def prepare() -> None:
    """Start the process from which others are forked; it ends with this one."""
    multiprocessing.set_forkserver_preload(["tests.preloaded"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[1]), prepend=os.pathsep)
        forkserver.ensure_running()


_get_context = multiprocessing.get_context


def get_context(method: str | None = None) -> BaseContext:
    """Replace `multiprocessing.get_context`: a process that would be spawned is forked from the prepared one."""
    return _Context() if method == "spawn" else _get_context(method)
