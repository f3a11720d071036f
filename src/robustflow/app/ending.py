"""End an app whose model keeps it from ending.

Python's signal handlers run between two of its instructions, and a model that is being loaded or compiled may be inside
one for minutes, with the interpreter's lock held. The operating system still writes the number of a signal to a file
descriptor (`signal.set_wakeup_fd`). Another process reads it, and ends the app if that does not end by itself.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

SECONDS = 8.0
"""Seconds between Ctrl-C and the end of an app that does not end by itself."""

_WATCH = f"""
import os, select, signal, sys
while True:
    sent = os.read(0, 1)
    if not sent:
        sys.exit()
    if sent[0] in ({signal.SIGINT:d}, {signal.SIGTERM:d}):
        break
while select.select([0], [], [], {SECONDS})[0]:
    if not os.read(0, 1):
        sys.exit()
os.kill(int(sys.argv[1]), signal.SIGKILL)
"""


def end_after_signal() -> None:
    """Make SIGINT and SIGTERM end this process after at most `SECONDS`, whatever its threads do.

    The other process ends with this one, because the other end of its pipe closes.
    """
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    command = [sys.executable, "-I", "-S", "-c", _WATCH, str(os.getpid())]
    subprocess.Popen(command, stdin=reads, start_new_session=True)
    os.close(reads)
    signal.set_wakeup_fd(writes, warn_on_full_buffer=False)
