"""Where a model failed: the line of its own code, for the one-line error message."""

from __future__ import annotations

import traceback
from pathlib import Path

_PACKAGE = str(Path(__file__).resolve().parent.parent)


def where_raised(error: BaseException) -> str:
    """The last line of the user's code that an exception passed, or else the last at all: " (at net.py:12)".

    Code of libraries and of this package is skipped if there is other code.

    >>> try:
    ...     {}["a"]
    ... except KeyError as error:
    ...     print(where_raised(error).endswith(":2)"))
    True
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.lineno]
    if not frames:
        return ""
    own = [frame for frame in frames if not _is_library(frame.filename)]
    outside = [frame for frame in frames if not frame.filename.startswith(_PACKAGE)]
    last = (own or outside or frames)[-1]
    return f" (at {last.filename}:{last.lineno})"


def _is_library(file: str) -> bool:
    return file.startswith(_PACKAGE) or "site-packages" in file or "dist-packages" in file or "/lib/python" in file
