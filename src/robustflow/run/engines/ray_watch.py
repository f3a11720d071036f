"""Wait for the end of the process that started Ray on this machine; a script that this process starts with a pipe.

When one of Ray's processes is lost, Ray terminates its driver in a way that Python cannot catch, and the processes of a
driver that was killed may outlive it. This script then ends them, removes their folder, and prints a message.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path


def processes_with_files_in(folder: str) -> set[int]:
    """Return the processes that have a file of a folder open. Some of Ray's overwrite their command and environment."""
    numbers = set()
    for process in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            number = int(process.name)
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    if os.readlink(descriptor).startswith(f"{folder}/"):
                        numbers.add(number)
    return numbers


def main(message: str, folder: str = "") -> None:
    """Print the message if standard input closes before a byte arrives."""
    if sys.stdin.buffer.read(1):
        return
    while folder and (left := processes_with_files_in(folder)):  # one that is starting may have started another
        for number in left:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        time.sleep(0.1)
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
    sys.exit(message)


if __name__ == "__main__":
    main(*sys.argv[1:])
