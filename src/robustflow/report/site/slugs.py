"""Ids of model pages: safe in an address and an attribute whatever the model is called."""

from __future__ import annotations

import re
from collections.abc import Hashable

_LONGEST = 40


class Slugs:
    """Gives every thing its own id of letters, digits and hyphens, always the same one.

    >>> slugs = Slugs()
    >>> slugs.of(1, "SAMFlow-H"), slugs.of(2, "samflow h"), slugs.of(1, "SAMFlow-H"), slugs.of(3, "<>")
    ('samflow-h', 'samflow-h-2', 'samflow-h', 'model')
    """

    def __init__(self) -> None:
        self._of: dict[Hashable, str] = {}

    def of(self, thing: Hashable, name: str) -> str:
        """The id of a thing called `name`."""
        if thing not in self._of:
            words = name.replace("+", " plus ").lower()
            stem = re.sub(r"[^a-z0-9]+", "-", words)[:_LONGEST].strip("-") or "model"
            taken, slug, count = set(self._of.values()), stem, 1
            while slug in taken:
                count += 1
                slug = f"{stem}-{count}"
            self._of[thing] = slug
        return self._of[thing]
