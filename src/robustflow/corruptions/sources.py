"""Identifiers of user files that affect the output of corruptions, as part of the identity of results."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from .api import load_corruption
from .own import own_corruption
from .registry import CORRUPTIONS, SHIPPED
from .stack import split_stack

if TYPE_CHECKING:
    from .base import Corruption


OWN_KEY = "corruptions"
"""Key for custom corruptions and those from installed packages; its value maps each name to a hash of the source."""


def user_sources(variant: str = "default", names: Iterable[str] = ()) -> dict[str, Any]:
    """Return identifiers of the user files in use, keyed by `Corruption.source_key`; empty if no user files are
    used.
    """
    sources = {kind.source_key: load_corruption(kind.name, variant).source for kind in _kinds_with_sources()}
    parts = {part for name in names for part, _ in split_stack(name)}
    own = {part: one.source for part in sorted(parts) if (one := own_corruption(part, variant)) is not None}
    return {key: source for key, source in sources.items() if source} | ({OWN_KEY: own} if own else {})


def _kinds_with_sources() -> list[type[Corruption]]:
    return [kind for kind in map(CORRUPTIONS.get, SHIPPED) if kind.source_key]
