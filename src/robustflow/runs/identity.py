"""The identity of a run: its digest, and in what two of them differ."""

from __future__ import annotations

from typing import Any

from ..digest import digest_of_value


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
