"""Progress of a run: a bar with the time left on a terminal or in a notebook, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Protocol, runtime_checkable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar

from ..text import counted
from .engines.base import FinishedUnit

LINE_EVERY_S = 10.0
"""Seconds between lines of progress in a log."""


class Progress(Protocol):
    """Is notified of every finished unit."""

    def start(self, folder: Path, total: int, finished: int) -> None:
        """A run of `total` units starts; `finished` of them were finished by an earlier call."""

    def advance(self, done: FinishedUnit) -> None:
        """One more unit is on disk."""


@runtime_checkable
class NamesEngine(Protocol):
    """A `Progress` that also shows which engine computes."""

    def engine(self, name: str) -> None:
        """The engine of the run that is about to start: "processes, 1 device + 3 feeders"."""


class Silent:
    """A `Progress` that shows nothing."""

    def start(self, folder: Path, total: int, finished: int) -> None:
        """Nothing."""

    def advance(self, done: FinishedUnit) -> None:
        """Nothing."""


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress]:
    """The progress that a call of `evaluate` requests.

    Args:
        progress: the caller's own; True for a bar, or lines if there is no screen; False for none; None for a bar where
            it can be seen (standard error is a terminal, or a notebook), and nothing elsewhere.
    """
    if progress is None:
        console = Console(stderr=True)
        progress = console.is_terminal or console.is_jupyter
    if not isinstance(progress, bool):
        yield progress
    elif progress:
        with TerminalProgress() as bar:
            yield bar
    else:
        yield Silent()


class TerminalProgress:
    """Shows a run's progress on stderr. A context manager."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, markup=False)
        self._bar: Bar | None = None
        self._folder: Path | None = None
        self._engine = ""
        self._total = self._finished = self._finished_before = 0
        self._started = self._last_line = time.monotonic()

    def __enter__(self) -> TerminalProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def engine(self, name: str) -> None:
        """The engine of the run that is about to start."""
        self._engine = f"; engine: {name}"

    def start(self, folder: Path, total: int, finished: int) -> None:
        """A run of `total` units starts; `finished` of them were finished by an earlier call."""
        self._folder, self._total, self._finished, self._finished_before = folder, total, finished, finished
        self._started = self._last_line = time.monotonic()
        kept = f", {finished} of them already there" if finished else ""
        self._console.print(
            f"{folder}: {counted(total, 'step')} (a pair under one corruption each){kept}{self._engine}",
            highlight=False,
            soft_wrap=True,
        )
        self._engine = ""
        if self._console.is_terminal or (self._console.is_jupyter and find_spec("ipywidgets") is not None):
            columns = (
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
            )
            self._bar = Bar(TextColumn("{task.description}", markup=False), *columns, console=self._console)
            self._bar.add_task("", total=total, completed=finished)
            self._bar.start()

    def advance(self, done: FinishedUnit) -> None:
        """One more unit is on disk."""
        self._finished += 1
        what = f"{done.unit.key} {done.unit.corruption}" + (f" on {done.place}" if done.place else "")
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], advance=1, description=what)
        elif time.monotonic() - self._last_line >= LINE_EVERY_S or self._finished == self._total:
            self._last_line = time.monotonic()
            spent = self._last_line - self._started
            left = spent / (self._finished - self._finished_before) * (self._total - self._finished)
            share = 100 * self._finished / self._total
            print(
                f"{self._finished}/{self._total} ({share:.0f} %), {left:.0f} s left, last {what}",
                file=sys.stderr,
                flush=True,
            )

    def kept(self) -> str:
        """What a stopped run has kept, as a sentence."""
        if self._folder is None:
            return "nothing had been computed."
        return f"{self._finished} of {counted(self._total, 'step')} are kept in {self._folder}."
