"""Shell completion of names, and the end of a command on Ctrl-C, with one line that says what was saved."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from typing import Any

import typer


def terminate_as_on_ctrl_c() -> None:
    """Raise KeyboardInterrupt on a request to terminate, too."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def stopped(kept: str) -> typer.Exit:
    """Print what a stopped command has kept and how to continue, and return the exception that ends it."""
    typer.echo(f"robustflow: stopped; {kept} to continue.", err=True)
    return typer.Exit(130)


class Interrupted:
    """A signal handler that records whether Ctrl-C was pressed or termination was requested; a second request ends the
    process immediately."""

    def __init__(self) -> None:
        self._came = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def __call__(self) -> bool:
        return self._came

    def _note(self, number: int, frame: Any) -> None:
        if self._came:
            raise KeyboardInterrupt
        self._came = True
        typer.echo("robustflow: stopping after this update; press Ctrl-C again to stop immediately", err=True)


def models(incomplete: str) -> list[str]:
    """Complete names of models.

    >>> models("farn")
    ['farneback']
    """
    from ..models import MODELS

    return _with_prefix(MODELS.names(), incomplete)


def checkpoints(incomplete: str) -> list[str]:
    """Complete names of published checkpoints of any model, and "random"."""
    from ..models.catalog import checkpoints as catalogue

    return _with_prefix(("random", *(entry.checkpoint for entry in catalogue())), incomplete)


def corruptions(incomplete: str) -> list[str]:
    """Complete the name of a corruption after the last comma or plus.

    >>> corruptions("fog,fro")
    ['fog,frost']
    """
    from ..corruptions import CORRUPTIONS

    cut = max(incomplete.rfind(","), incomplete.rfind("+")) + 1
    return [incomplete[:cut] + name for name in _with_prefix(CORRUPTIONS.names(), incomplete[cut:])]


def benchmarks(incomplete: str) -> list[str]:
    """Complete names of benchmarks, and of datasets, which can be used as benchmarks."""
    from ..data.benchmarks import BENCHMARKS
    from ..data.datasets import DATASETS

    return _with_prefix((*BENCHMARKS.names(), *DATASETS.names()), incomplete)


KINDS = ("models", "corruptions", "attacks", "benchmarks", "datasets", "recipes")
"""Categories of `list`."""


def kinds(incomplete: str) -> list[str]:
    """Complete the categories of `list`, and "all"."""
    return _with_prefix((*KINDS, "all"), incomplete)


def methods(incomplete: str) -> list[str]:
    """Complete names of methods with a training recipe."""
    from ..training.recipe import trained_methods

    return _with_prefix(trained_methods(), incomplete)


def tables(incomplete: str) -> list[str]:
    """Complete the name of a `report` table after the last comma."""
    from ..report.tables import TABLES

    cut = incomplete.rfind(",") + 1
    return [incomplete[:cut] + name for name in _with_prefix(TABLES, incomplete[cut:])]


def _with_prefix(names: Iterable[str], incomplete: str) -> list[str]:
    return list(dict.fromkeys(name for name in names if name.startswith(incomplete)))
