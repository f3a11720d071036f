"""Standard output, which only the results of a command reach: a model that prints would damage JSON or CSV there."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import TextIO

_results: TextIO | None = None


@contextmanager
def results_only() -> Iterator[None]:
    """Send to stderr whatever other code prints to stdout within the block, from Python, from C and from child
    processes; `echo` still writes to stdout."""
    global _results
    stdout = sys.stdout
    if _results is not None or stdout is None:
        yield
        return
    of_process = isinstance(stdout, TextIOWrapper) and stdout is sys.__stdout__ and stdout.fileno() == 1
    _results = stdout
    if of_process:
        stdout.flush()
        _results = open(os.dup(1), "w", encoding=stdout.encoding, errors=stdout.errors)  # noqa: SIM115
        os.dup2(2, 1)
    sys.stdout = sys.stderr
    try:
        yield
    finally:
        results, _results, sys.stdout = _results, None, stdout
        if of_process:
            print(end="", flush=True)
            ctypes.CDLL(None).fflush(None)  # C code prints into a buffer of its library
            os.dup2(results.fileno(), 1)
            results.close()


def end_results() -> None:
    """Send to stderr what other code prints while the process ends."""
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout is sys.__stdout__:
        sys.stdout.flush()
        os.dup2(2, 1)


def stream() -> TextIO:
    """Return the stream of the results: stdout."""
    return _results or sys.stdout


def echo(text: str = "", end: str = "\n") -> None:
    """Print a part of a command's results."""
    print(text, end=end, file=stream(), flush=True)  # not by click, which ignores a terminal's small character set
