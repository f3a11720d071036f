"""Standard output, which only the results of a command reach: a model that prints would damage JSON or CSV there."""

from __future__ import annotations

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
    processes; `echo` still writes to stdout. If stdout is that of the process, this lasts until the process ends, when
    buffers are written."""
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
        if not of_process:
            _results, sys.stdout = None, stdout


def stream() -> TextIO:
    """Return the stream of the results: stdout."""
    return _results or sys.stdout


def echo(text: str = "", end: str = "\n") -> None:
    """Print a part of a command's results."""
    print(text, end=end, file=stream(), flush=True)  # not by click, which ignores a terminal's small character set
