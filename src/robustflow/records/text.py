"""Read JSON from elsewhere strictly, and refuse text that could do more than be displayed."""

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
"""Largest number of characters of a text in a record."""

_DEEPEST = 24
_PATH = re.compile(r"""(?:^|[\s'"=;,(\[])(?:/[^/\s]+/|~[/\\]|[A-Za-z]:[\\/]|\\\\)""")


def read_json(data: bytes, name: str) -> dict[str, Any]:
    """A JSON object, as `json_bytes` writes it.

    Raises:
        DataError: not JSON, not an object, not in the form `json_bytes` gives it (no repeated keys, no NaN, no other
            notation of numbers), nested too deeply, or with text that `check_text` refuses.

    >>> read_json(b'{\\n  "a": 1\\n}\\n', "x.json")
    {'a': 1}
    >>> read_json(b'{"a": NaN}', "x.json")
    Traceback (most recent call last):
    robustflow.errors.DataError: x.json is not JSON (NaN is not a number)
    """
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
        raise DataError(f"{name} is not written as a record writes it (order of names, notation of numbers, spaces)")
    return value


def check_text(text: str, where: str) -> None:
    """Raise for text that is too long to be shown, and for characters that control a terminal or a page.

    Raises:
        DataError: more than `LONGEST` characters, or a control, direction or other invisible character.

    >>> check_text("RAFT\\x1b[31m", "author")
    Traceback (most recent call last):
    robustflow.errors.DataError: author: 'RAFT�[31m' holds a character that cannot be shown; remove it
    """
    if len(text) > LONGEST:
        raise DataError(f"{where}: {len(text)} characters, where a record holds at most {LONGEST}; shorten it")
    if not text.isprintable() and any(unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co", "Zl", "Zp") for c in text):
        raise DataError(f"{where}: '{plain(text, 60)}' holds a character that cannot be shown; remove it")


def texts(value: Any) -> Iterator[tuple[str, str]]:
    """Every text inside a JSON value, including names, with its position.

    Raises:
        ValueError: nested too deeply.

    >>> list(texts({"a": ["x", 1]}))
    [('', 'a'), ('a.0', 'x')]
    """
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
    """Whether a text contains a path of a machine: an absolute path, or one from a home folder.

    >>> [holds_path(t) for t in ("/home/ada/w.pth", "~/w.pth", "--data /data/kitti", "a/b.png", "1/2 / 3")]
    [True, True, True, False, False]
    >>> holds_path("https://example.org/a/b")
    False
    """
    return _PATH.search(text) is not None


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not a number")
