"""Which of the user's files decide the bytes of corruptions: part of the identity of whatever is made with them."""

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
"""The key of the user's own corruptions, and those of installed packages: name to the digest of their source."""


def user_sources(variant: str = "default", names: Iterable[str] = ()) -> dict[str, Any]:
    """What names the files that are set up now, by `Corruption.source_key`; empty where no file of the user's is used.

    It does not depend on which of this package's corruptions are requested, so that a later call with others adds to
    the same run. Other people's corruptions among `names`, and in stacks, count with the digest of their source: a run
    with an edited one is a different run.

    >>> user_sources()
    {}
    """
    sources = {kind.source_key: load_corruption(kind.name, variant).source for kind in _kinds_with_sources()}
    parts = {part for name in names for part, _ in split_stack(name)}
    own = {part: one.source for part in sorted(parts) if (one := own_corruption(part, variant)) is not None}
    return {key: source for key, source in sources.items() if source} | ({OWN_KEY: own} if own else {})


def _kinds_with_sources() -> list[type[Corruption]]:
    return [kind for kind in map(CORRUPTIONS.get, SHIPPED) if kind.source_key]
