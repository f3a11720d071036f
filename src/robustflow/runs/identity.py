"""The identity of a run: its digest, and in what two of them differ."""

from __future__ import annotations

from typing import Any

from ..digest import digest_of_value
from ..errors import UsageError

LONGEST_NAME = 80
"""Characters of a model's name in tables and figures."""


def identity_digest(identity: dict[str, Any]) -> str:
    """A stable hash of an identity, the same from a plan as from the manifest it was written to.

    >>> identity_digest({"a": 1, "b": 2}) == identity_digest({"b": 2, "a": 1})
    True
    """
    return digest_of_value(identity)


def differing(now: dict[str, Any], before: dict[str, Any]) -> str:
    """The parts in which two identities differ.

    >>> differing({"seed": 1, "model": "a"}, {"seed": 0, "model": "a"})
    'seed'
    """
    names = sorted(key for key in now.keys() | before.keys() if now.get(key) != before.get(key))
    return ", ".join(names) or "identity"


def checked_name(name: str) -> str:
    """A name for a model in tables and figures, without spaces around it.

    >>> checked_name(" My model ")
    'My model'

    Raises:
        UsageError: empty, longer than `LONGEST_NAME` characters, or with characters that cannot be printed.
    """
    name = name.strip()
    if not name or len(name) > LONGEST_NAME or not name.isprintable():
        raise UsageError(f"the name of a model must be 1 to {LONGEST_NAME} printable characters, not {name[:100]!r}")
    return name
