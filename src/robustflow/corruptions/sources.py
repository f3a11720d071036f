"""Which of the user's files decide the bytes of corruptions: part of the identity of whatever is made with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .registry import CORRUPTIONS, SHIPPED

if TYPE_CHECKING:
    from .base import Corruption


def user_sources(variant: str = "default") -> dict[str, str]:
    """What names the files that are set up now, by `Corruption.source_key`; empty where no file of the user's is used.

    It does not depend on which corruptions are asked for, so that a later call with others adds to the same run.

    >>> user_sources()
    {}
    """
    sources = {kind.source_key: kind(variant).source for kind in _kinds_with_sources()}
    return {key: source for key, source in sources.items() if source}


def recorded_sources(identity: Mapping[str, Any]) -> dict[str, Any]:
    """What `user_sources` gave where an identity was made.

    >>> recorded_sources({"seed": 0, "psf": "reference 0123456789ab"})
    {'psf': 'reference 0123456789ab'}
    """
    return {kind.source_key: identity[kind.source_key] for kind in _kinds_with_sources() if kind.source_key in identity}


def _kinds_with_sources() -> list[type[Corruption]]:
    return [kind for kind in map(CORRUPTIONS.get, SHIPPED) if kind.source_key]
