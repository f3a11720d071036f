"""Choose the next unit for an idle worker."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from ...metrics.rows import CLEAN
from ...runs.plan import Unit


class Schedule:
    """Assign units so that a sample's clean flow is computed first, a worker continues with the sample it has
    loaded, and as few samples as possible are in progress. After the clean unit, a sample's units are assigned in
    reverse order, because the costliest corruption (psf_blur) is at the end of the plan: if it started last, one
    worker would be busy while the others are idle.
    """

    def __init__(self, units: Iterable[Unit]) -> None:
        self._waiting: dict[str, deque[Unit]] = {}
        """Units by sample, with the samples in the plan's order."""
        self._blocked: set[str] = set()
        """Samples whose clean unit is being computed."""
        for unit in units:
            self._waiting.setdefault(unit.key, deque()).append(unit)
        self._fresh = [key for key, mine in reversed(self._waiting.items()) if mine[0].corruption == CLEAN]
        """Samples that no worker has started, in reverse order."""

    def take(self, last_key: str | None) -> Unit | None:
        """Return the next unit for a worker that has `last_key` loaded; None if all remaining units have to wait."""
        if last_key is not None and self._ready(last_key):
            return self._pop(last_key)
        if self._fresh:  # prefer a new sample, because two workers on the same sample load it twice
            key = self._fresh.pop()
            self._blocked.add(key)
            return self._pop(key)
        for key in self._waiting:
            if self._ready(key):
                return self._pop(key)
        return None

    def finished(self, unit: Unit) -> None:
        """Record that a unit is done; a clean unit allows the rest of its sample to start."""
        if unit.corruption == CLEAN:
            self._blocked.discard(unit.key)

    def give_back(self, unit: Unit) -> None:
        """Put a unit whose worker was lost back into the queue, ahead of the rest of its sample."""
        waiting = self._waiting.setdefault(unit.key, deque())
        if unit.corruption == CLEAN:
            waiting.appendleft(unit)
            self._blocked.discard(unit.key)
            self._fresh.append(unit.key)
        else:
            waiting.append(unit)

    def _ready(self, key: str) -> bool:
        return key in self._waiting and key not in self._blocked and key not in self._fresh

    def _pop(self, key: str) -> Unit:
        waiting = self._waiting[key]
        unit = waiting.popleft() if waiting[0].corruption == CLEAN else waiting.pop()
        if not self._waiting[key]:
            del self._waiting[key]
        return unit
