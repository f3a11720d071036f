"""What a terminal and a figure show: a progress bar, and matplotlib with its default settings."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from .text import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .types import Frame

T = TypeVar("T")

LINE_EVERY_S = 10.0
"""Seconds between progress lines in a log."""


class _TrackedWork(NamedTuple):
    total: int
    first: int
    started: float
    bar: Any


class ProgressBar:
    """Shows the progress of tasks on stderr: a bar on a terminal or in a notebook, plain lines in a log. A context
    manager.
    """

    def __init__(self, shown: bool = True) -> None:
        from rich.console import Console

        self._shown = shown
        self._console = Console(stderr=True, markup=False)
        self._tasks: dict[str, _TrackedWork] = {}
        self._bar: Any = None
        self._last_line = time.monotonic()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
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
                from rich import progress

                self._bar = progress.Progress(
                    progress.TextColumn("{task.description}", markup=False),
                    progress.BarColumn(),
                    progress.MofNCompleteColumn(),
                    progress.TimeElapsedColumn(),
                    progress.TextColumn("left"),
                    progress.TimeRemainingColumn(),
                    console=console,
                )
                self._bar.start()
            bar = self._bar.add_task(plain(task, None), total=total, completed=done)
        self._tasks[task] = _TrackedWork(total, done, time.monotonic(), bar)

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


_LOCAL_SETTINGS = "matplotlibrc"


def ignore_local_settings() -> None:
    """Import matplotlib without reading the working folder's `matplotlibrc`. matplotlib reads this file on first
    import, and fails if it is not a text file.
    """
    if not os.path.lexists(_LOCAL_SETTINGS):
        return
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(os.sep)
        import matplotlib  # noqa: F401
    finally:
        os.fchdir(here)
        os.close(here)


@contextmanager
def default_style() -> Iterator[None]:
    """Use matplotlib's defaults for figures made and saved within the block or the decorated function.

    >>> import matplotlib
    >>> with default_style():
    ...     matplotlib.rcParams["lines.linewidth"]
    1.5
    """
    import matplotlib

    with matplotlib.rc_context(
        {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    ):
        yield


def add_picture(
    figure: Figure, left: float, top: float, width: float, height: float, picture: Frame, title: str, size: float
) -> None:
    """Add a picture with a title above it to a figure, without axes, because drawing ticks takes longer than drawing
    the picture.
    """
    from matplotlib.image import BboxImage
    from matplotlib.transforms import Bbox, TransformedBbox

    below = figure.get_figheight() - top - height
    place = TransformedBbox(Bbox.from_bounds(left, below, width, height), figure.dpi_scale_trans)
    figure.add_artist(BboxImage(place, interpolation="antialiased", data=picture))
    above = below + height + 0.3 * size / 72
    figure.text(left, above, title, fontsize=size, transform=figure.dpi_scale_trans, parse_math=False)
