"""Progress of clip preparation: a bar per clip and stage on a terminal, a line every ten seconds in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from ..runner.progress import LINE_EVERY_S


class VideoProgress:
    """Called with (clip, stage, done, total). A context manager."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=console) if console.is_terminal else None
        self._tasks: dict[tuple[str, str], TaskID] = {}
        self._last_line = time.monotonic()

    def __enter__(self) -> VideoProgress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, clip: str, stage: str, done: int, total: int) -> None:
        """`done` of `total` frames of a stage of a clip are finished."""
        if self._bar is not None:
            task = self._tasks.get((clip, stage))
            if task is None:
                task = self._tasks[clip, stage] = self._bar.add_task(f"{clip} {stage}", total=total)
            self._bar.update(task, completed=done)
        elif time.monotonic() - self._last_line >= LINE_EVERY_S or done == total:
            self._last_line = time.monotonic()
            print(f"{clip}: {stage} {done}/{total}", file=sys.stderr, flush=True)
