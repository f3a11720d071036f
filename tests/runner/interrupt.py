"""Helpers for commands that a test interrupts the way a terminal does."""

from __future__ import annotations

import signal


def hears_ctrl_c() -> None:
    """Enable Ctrl-C in a new process even if the tests run in the background, where the signal is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
