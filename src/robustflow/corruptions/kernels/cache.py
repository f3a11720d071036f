"""Keep what is expensive to compute for frames of one size, up to a limit in bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any


class BytesCache:
    """A cache of values with an attribute `nbytes`; above the limit, the least recently used ones are removed."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._entries: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        """Return the value for a key, computing it if it is not cached."""
        with self._lock:
            value = self._entries.pop(key, None)
        value = compute() if value is None else value
        with self._lock:
            self._entries[key] = value
            while self.nbytes > self.limit:
                self._entries.popitem(last=False)
        return value

    def clear(self) -> None:
        self._entries.clear()

    @property
    def nbytes(self) -> int:
        return sum(value.nbytes for value in self._entries.values())
