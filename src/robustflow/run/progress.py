"""Show the progress of a run: a bar with the remaining time on a terminal or in a notebook, plain lines in a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console

from ..core.display import ProgressBar
from ..core.errors import UsageError
from ..core.text import counted, plain
from .computation import FinishedUnit

DRAWN = ("worst example", "median example", "severity slider", "page")
"""What is drawn after the numbers of a run are known, in this order."""
_DRAWING = "pictures and page"


class Progress(Protocol):
    """An object that is notified of every finished unit."""

    def start(self, folder: Path, total: int, finished: int) -> None:
        """Start a run of `total` units, of which `finished` were completed by earlier calls."""

    def advance(self, done: FinishedUnit) -> None:
        """Record that one more unit is on disk; called in the thread that writes rows."""


class Silent:
    """A `Progress` that shows nothing."""

    def start(self, folder: Path, total: int, finished: int) -> None:
        pass

    def advance(self, done: FinishedUnit) -> None:
        pass

    def measured(self, result: Any) -> None:
        pass

    def drawing(self, what: str = "") -> None:
        pass


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress]:
    """Return the progress object for a call of `evaluate`."""
    if progress is None:
        console = Console(stderr=True)
        progress = console.is_terminal or console.is_jupyter
    if not isinstance(progress, bool):
        if not hasattr(progress, "start"):
            raise UsageError("progress", f"must be true, false or an object with start and advance, not {progress!r}")
        yield progress
    elif progress:
        with TerminalProgress() as bar:
            yield bar
    else:
        yield Silent()


class TerminalProgress:
    """A context manager that shows a run's progress on stderr: first that of its rows, then that of its pictures. In
    between, it calls `show_numbers` with the result.
    """

    def __init__(self, show_numbers: Callable[[Any], None] = lambda result: None) -> None:
        self._show_numbers = show_numbers
        self._console = Console(stderr=True, markup=False)
        self._bar = ProgressBar()
        self._folder: str | None = None
        self._engine = ""
        self._total = self._finished = self._evaluations = 0

    def __enter__(self) -> TerminalProgress:
        return self

    def __exit__(self, *raised: Any) -> None:
        self._bar.__exit__(*raised)

    def engine(self, name: str) -> None:
        """Show the engine of the run that is about to start: "processes, 1 device + 3 feeders"."""
        self._engine = f"; engine: {name}"

    def start(self, folder: Path, total: int, finished: int) -> None:
        """Start a run of `total` units, of which `finished` were completed by earlier calls."""
        self._folder, self._total = plain(str(folder), None), total
        self._finished, self._evaluations = finished, 0
        already = f", {finished} already finished" if finished else ""
        self._console.print(
            f"{self._folder}: {counted(total, 'step')} (one pair under one condition per step){already}{self._engine}",
            highlight=False,
            soft_wrap=True,
        )
        self._engine = ""
        self._bar.start("", total, finished)

    def advance(self, done: FinishedUnit) -> None:
        """Record that one more unit is on disk."""
        self._finished += 1
        self._evaluations += sum(row.get("attack_evaluations") or 0 for row in done.rows)
        place = f" on {done.place}" if done.place else ""
        evaluations = f"; {self._evaluations:,} model evaluations by attacks" if self._evaluations else ""
        self._bar.update("", self._finished, f"last {done.unit.key} {done.unit.corruption}{place}{evaluations}")

    def measured(self, result: Any) -> None:
        """Show the numbers of a run whose rows are complete, before anything is drawn."""
        self._bar.__exit__()
        self._show_numbers(result)
        self._bar.start(_DRAWING, len(DRAWN))

    def drawing(self, what: str = "") -> None:
        """Show which one of `DRAWN` comes next; "" after the last one."""
        self._bar.update(_DRAWING, DRAWN.index(what) if what else len(DRAWN), what)

    def finished_work(self) -> str:
        if self._folder is None:
            return "nothing had been computed."
        return f"{self._finished} of {counted(self._total, 'step')} are saved in {self._folder}."
