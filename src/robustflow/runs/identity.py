"""The identity of a run: its digest, and how two of them differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..corruptions.sources import OWN_KEY
from ..digest import digest_of_value
from ..errors import UsageError

_MODEL = ("model", "window")
_MEASURING = ("version", "rows", "allow_invalid")
"""With `_MODEL` everything that leaves the frames as they are; a new part counts among the frames."""

LONGEST_NAME = 80
"""The most characters that a model's name in tables and figures may have."""


def identity_digest(identity: dict[str, Any]) -> str:
    """A stable hash of an identity, the same from a plan as from the manifest it was written to.

    >>> identity_digest({"a": 1, "b": 2}) == identity_digest({"b": 2, "a": 1})
    True
    """
    return digest_of_value(identity)


def frames_part(identity: Mapping[str, Any]) -> dict[str, Any]:
    """The part of an identity that determines which frames a model is given: all but the model and what is measured.

    >>> frames_part({"seed": 0, "model": {"name": "dis"}, "rows": 3})
    {'seed': 0}
    """
    return {name: value for name, value in identity.items() if name not in (*_MODEL, *_MEASURING)}


def model_part(identity: Mapping[str, Any]) -> dict[str, Any]:
    """The part of an identity that names the model, and the frames around a pair that it is given.

    >>> model_part({"seed": 0, "model": {"name": "dis"}, "rows": 3})
    {'model': {'name': 'dis'}}
    """
    return {name: identity[name] for name in _MODEL if name in identity}


def differing(now: dict[str, Any], before: dict[str, Any]) -> str:
    """The parts in which two identities differ.

    >>> differing({"seed": 1, "model": "a"}, {"seed": 0, "model": "a"})
    'seed'
    """
    names = sorted(key for key in now.keys() | before.keys() if now.get(key) != before.get(key))
    return ", ".join(names) or "identity"


def describe_difference(now: dict[str, Any], before: dict[str, Any]) -> str:
    """How two identities differ, in words; the user's own corruptions are named.

    >>> describe_difference({"seed": 0, "corruptions": {"rain": "b"}}, {"seed": 0, "corruptions": {"rain": "a"}})
    'the source of the corruption rain has changed since'
    >>> describe_difference({"seed": 0, "corruptions": {"rain": "b"}}, {"seed": 0})
    'it was begun without your corruption rain'
    """
    parts = differing(now, before)
    if parts != OWN_KEY:
        return f"it differs in: {parts}"
    if edited := edited_corruptions(now, before):
        return f"the source of the corruption {', '.join(edited)} has changed since"
    if added := [name for name in now.get(OWN_KEY, {}) if name not in before.get(OWN_KEY, {})]:
        return f"it was begun without your corruption {', '.join(added)}"
    return f"it was begun with the corruption {', '.join(map(str, before[OWN_KEY]))} besides"


def edited_corruptions(now: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """The user's corruptions whose source differs between two identities; none if anything else differs as well."""
    mine, recorded = now.get(OWN_KEY, {}), before.get(OWN_KEY, {})
    if differing(now, before) != OWN_KEY or not isinstance(recorded, dict):
        return []
    return [name for name in mine if name in recorded and mine[name] != recorded[name]]


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
