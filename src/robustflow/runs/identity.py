"""The identity of a run: its digest, and in what two of them differ."""

from __future__ import annotations

import hashlib
import json
from typing import Any


def identity_digest(identity: dict[str, Any]) -> str:
    """A stable hash of an identity, the same from a plan as from the manifest it was written to.

    >>> identity_digest({"a": 1, "b": 2}) == identity_digest({"b": 2, "a": 1})
    True
    """
    spelled = json.dumps(identity, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(spelled.encode(), digest_size=8).hexdigest()


def differing(now: dict[str, Any], before: dict[str, Any]) -> str:
    """The parts in which two identities differ.

    >>> differing({"seed": 1, "model": "a"}, {"seed": 0, "model": "a"})
    'seed'
    """
    names = sorted(key for key in now.keys() | before.keys() if now.get(key) != before.get(key))
    return ", ".join(names) or "identity"
