"""Show progress: a bar with the remaining time on a terminal or in a notebook, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from types import TracebackType
from typing import NamedTuple, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from .text import plain

T = TypeVar("T")

LINE_EVERY_S = 10.0
"""Seconds between progress lines in a log."""


class _Task(NamedTuple):
    total: int
    first: int
    started: float
    bar: TaskID | None


class ProgressBar:
    """Shows the progress of one or more tasks on stderr. A context manager."""

    def __init__(self, shown: bool = True) -> None:
        self._shown = shown
        self._console = Console(stderr=True, markup=False)
        self._tasks: dict[str, _Task] = {}
        self._bar: Progress | None = None
        self._last_line = time.monotonic()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        self._bar = None
        self._tasks.clear()

    def start(self, task: str, total: int, done: int = 0) -> None:
        """Add a task of `total` steps, of which an earlier call completed `done`."""
        bar = None
        console = self._console
        if self._shown and (console.is_terminal or (console.is_jupyter and find_spec("ipywidgets") is not None)):
            if self._bar is None:
                times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
                text = TextColumn("{task.description}", markup=False)
                self._bar = Progress(text, BarColumn(), MofNCompleteColumn(), *times, console=console)
                self._bar.start()
            bar = self._bar.add_task(plain(task, None), total=total, completed=done)
        self._tasks[task] = _Task(total, done, time.monotonic(), bar)

    def update(self, task: str, done: int, what: str = "") -> None:
        """Show that `done` steps of a task are complete; `what` describes the last one."""
        total, first, started, bar = self._tasks[task]
        name, what = plain(task, None), plain(what, None)
        if self._bar is not None and bar is not None:
            self._bar.update(bar, completed=done, description=" ".join(part for part in (name, what) if part))
        elif self._shown and (time.monotonic() - self._last_line >= LINE_EVERY_S or done == total):
            self._last_line = time.monotonic()
            left = (self._last_line - started) / max(done - first, 1) * (total - done)
            parts = (f"{name} {done}/{total} ({100 * done / total:.0f} %)".strip(), f"{left:.0f} s left", what)
            print(", ".join(part for part in parts if part), file=sys.stderr, flush=True)

    def track(self, items: Iterable[T], task: str, total: int) -> Iterator[T]:
        """Yield the items of a task, and show how many of the `total` items are done."""
        self.start(task, total)
        for done, item in enumerate(items, 1):
            yield item
            self.update(task, done)

    def stage(self, clip: str, stage: str, done: int, total: int) -> None:
        """Show that `done` of `total` frames of a clip are finished in one `stage`, see `video.prepare.Progress`."""
        task = f"{clip}: {stage}"
        if task not in self._tasks:
            self.start(task, total)
        self.update(task, done)
