"""Find the line of user code at which a model failed, for one-line error messages."""

from __future__ import annotations

import traceback
from pathlib import Path

_PACKAGE = str(Path(__file__).resolve().parent.parent)


def traceback_hint(error: BaseException) -> str:
    """Return the last line of user code in a traceback as " (at net.py:12)"; if there is none, return the last line of
    the traceback.

    >>> try:
    ...     {}["a"]
    ... except KeyError as error:
    ...     print(traceback_hint(error).endswith(":2)"))
    True
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.lineno]
    if not frames:
        return ""
    user = [frame for frame in frames if not _is_library(frame.filename)]
    outside = [frame for frame in frames if not frame.filename.startswith(_PACKAGE)]
    last = (user or outside or frames)[-1]
    return f" (at {last.filename}:{last.lineno})"


def _is_library(file: str) -> bool:
    return file.startswith(_PACKAGE) or "site-packages" in file or "dist-packages" in file or "/lib/python" in file
