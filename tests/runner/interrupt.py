"""Commands that a test interrupts as a terminal would."""

from __future__ import annotations

import signal


def hears_ctrl_c() -> None:
    """In a process as it starts: take Ctrl-C, also where the tests themselves run in the background, deaf to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
