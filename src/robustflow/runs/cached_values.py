"""Cache the values that pages show about a run, apart from its means, in a hidden file in the run's folder. They are
valid only for the rows from which they were computed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from ..atomic import json_bytes
from .staleness import CACHED_VALUES_FILE, is_current, write_made

Cached = TypeVar("Cached")
_LARGEST = 2**24


class CachedValues:
    """Cached values by name, read once and computed if missing."""

    def __init__(self, folder: Path, source: str) -> None:
        self._folder, self._source = folder, source
        self._known = _read(folder, source)
        self._new = False

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def get(self, name: str, kind: type[Cached], make: Callable[[], Cached]) -> Cached:
        """Return a value; compute it if it is missing or has a different type."""
        if name in self._known:
            try:
                return TypeAdapter(kind).validate_python(self._known[name])
            except ValidationError:
                pass
        value = make()
        self._known[name], self._new = value, True
        return value

    def write(self) -> None:
        """Store the values computed since the file was read."""
        if self._new:
            write_made(self._folder, CACHED_VALUES_FILE, json_bytes(self._known), self._source)
            self._new = False


def _read(folder: Path, source: str) -> dict[str, Any]:
    path = folder / CACHED_VALUES_FILE
    try:
        if not is_current(folder, CACHED_VALUES_FILE, source) or path.stat().st_size > _LARGEST:
            return {}
        values = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}
