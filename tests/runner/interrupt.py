"""Helpers for commands that a test interrupts as a terminal would."""

from __future__ import annotations

import signal


def hears_ctrl_c() -> None:
    """Accept Ctrl-C in a starting process, even if the tests run in the background, where it is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
