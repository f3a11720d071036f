"""The end of a command on Ctrl-C, with one line that says what was saved."""

from __future__ import annotations

import signal
import sys
from typing import Any

import typer

from ..core.processes import STOP_SIGNALS


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
        for stop in STOP_SIGNALS:
            signal.signal(stop, self._note)

    def __call__(self) -> bool:
        return self._came

    def _note(self, number: int, frame: Any) -> None:
        self._came = True
        for stop in STOP_SIGNALS:  # Python would run a handler only between two operators of PyTorch
            signal.signal(stop, signal.SIG_DFL)
        if sys.stderr.isatty():
            sys.stderr.write("\x1b[?25h")  # show the cursor, which a progress bar hides
        typer.echo("robustflow: stopping after this update; press Ctrl-C again to stop immediately", err=True)
