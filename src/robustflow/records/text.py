"""Strictly parse JSON from untrusted sources, and reject text that is unsafe to display."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterator
from typing import Any

from ..atomic import json_bytes
from ..errors import DataError
from ..text import plain

LONGEST = 2000
"""Maximum length of a text field in a record, in characters."""

_DEEPEST = 24
_PATH = re.compile(r"""(?:^|[\s'"=;,(\[])(?:/[^/\s]+/|~[/\\]|[A-Za-z]:[\\/]|\\\\)""")


def read_json(data: bytes, name: str) -> dict[str, Any]:
    """Parse a JSON object that `json_bytes` wrote."""
    try:
        value = json.loads(data.decode(), parse_constant=_refuse)
        if not isinstance(value, dict):
            raise DataError(f"{name} is not a JSON object")
        for where, text in texts(value):
            check_text(text, f"{name}, {where or 'a name'}")
        canonical = json_bytes(value) == data
    except (ValueError, RecursionError) as error:
        raise DataError(f"{name} is not JSON ({plain(str(error), 80)})") from error
    if not canonical:
        raise DataError(f"{name} is not in canonical form (order of keys, notation of numbers, spaces)")
    return value


def check_text(text: str, where: str) -> None:
    r"""Raise for text that is too long to display, or that contains control characters.

    >>> check_text("RAFT\x1b[31m", "author")
    Traceback (most recent call last):
    robustflow.errors.DataError: author: 'RAFT�[31m' contains a character that cannot be displayed; remove it
    """
    if len(text) > LONGEST:
        raise DataError(f"{where}: {len(text)} characters, but a record allows at most {LONGEST}; shorten it")
    if not text.isprintable() and any(unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co", "Zl", "Zp") for c in text):
        raise DataError(f"{where}: '{plain(text, 60)}' contains a character that cannot be displayed; remove it")


def texts(value: Any) -> Iterator[tuple[str, str]]:
    """Yield every text inside a JSON value, including keys, with its position."""
    left: list[tuple[tuple[str, ...], Any]] = [((), value)]
    while left:
        where, one = left.pop()
        if len(where) > _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} levels deep")
        if isinstance(one, str):
            yield ".".join(part[:40] for part in where), one
        elif isinstance(one, dict):
            yield from (("", name) for name in one)
            left += [((*where, name), part) for name, part in one.items()]
        elif isinstance(one, list):
            left += [((*where, str(index)), part) for index, part in enumerate(one)]


def holds_path(text: str) -> bool:
    """Return whether a text contains a local path: an absolute path, or a path relative to a home folder.

    >>> [holds_path(t) for t in ("/home/ada/w.pth", "~/w.pth", "--data /data/kitti", "a/b.png", "1/2 / 3")]
    [True, True, True, False, False]
    >>> holds_path("https://example.org/a/b")
    False
    """
    return _PATH.search(text) is not None


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not a number")
