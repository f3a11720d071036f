"""Progress of a training: a bar with the time left on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ..runner.progress import LINE_EVERY_S


class TrainingProgress:
    """Shows a training's progress on standard error. A context manager.

    Args:
        shown: False for the processes that do not lead.
    """

    def __init__(self, shown: bool = True) -> None:
        self._shown = shown
        self._console = Console(stderr=True, markup=False)
        self._bar: Progress | None = None
        self._first = self._last = 0
        self._began = self._line = time.monotonic()

    def __enter__(self) -> TrainingProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def start(self, first: int, last: int) -> None:
        """The updates from `first` to `last` begin."""
        self._first, self._last = first, last
        self._began = self._line = time.monotonic()
        if self._shown and self._console.is_terminal:
            times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                *times,
                console=self._console,
            )
            self._bar.add_task("", total=last, completed=first)
            self._bar.start()

    def advance(self, done: int, numbers: dict[str, float]) -> None:
        """This many updates are made; the last one had these numbers."""
        if not self._shown:
            return
        what = f"loss {numbers['loss']:.3g}, EPE {numbers['epe']:.3g} px" if "epe" in numbers else ""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done, description=what)
        elif time.monotonic() - self._line >= LINE_EVERY_S or done == self._last:
            self._line = time.monotonic()
            left = (self._line - self._began) / max(done - self._first, 1) * (self._last - done)
            share = 100 * done / self._last
            print(f"update {done}/{self._last} ({share:.0f} %), {left:.0f} s left, {what}", file=sys.stderr, flush=True)
