"""Choose the next cell for each feeder, and track which units are finished.

A feeder continues with the sample it has loaded. The next cell depends on how many frames are waiting for the model: a
costly corruption if there are enough, a cheap one if they are running out. Slow corruptions (lens blur takes a second)
therefore never keep the model waiting, wherever they are in the plan; costs are measured during the run.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from ...metrics.rows import CLEAN
from ...runs.cells import Cell
from ...runs.plan import Unit
from .base import FinishedUnit


@dataclass
class _Open:
    """A unit whose cells are being assigned."""

    unit: Unit
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class CellSchedule:
    """Assign each cell of the units once, and collect the rows."""

    def __init__(self, units: Iterable[Unit]) -> None:
        self._waiting: dict[str, list[Unit]] = {}
        """Units of samples that have not been started, in the plan's order."""
        for unit in units:
            self._waiting.setdefault(unit.key, []).append(unit)
        self._fresh = list(reversed(self._waiting))
        """Samples that no feeder has started, in reverse order."""
        self._cells: dict[str, list[Cell]] = {}
        """Remaining cells of the samples that were started."""
        self._blocked: set[str] = set()
        """Samples whose clean cell is being computed."""
        self._open: dict[tuple[str, str], _Open] = {}
        self._cost: dict[str, float] = {}

    @property
    def finished(self) -> bool:
        """Whether every unit is finished."""
        return not self._waiting and not self._open

    def take(self, last_key: str | None, has_backlog: bool) -> Cell | None:
        """Return the next cell for a feeder; None if all remaining cells have to wait."""
        key = last_key if last_key in self._cells else None
        if key is None and self._fresh:
            key = self._fresh.pop()
            self._begin(key)
        if key is None:
            key = next((key for key in self._cells if key not in self._blocked), None)
        if key is None:
            return None
        cells = self._cells[key]
        cell = cells.pop(self._choice(cells, has_backlog))
        if not cells:
            del self._cells[key]
        return cell

    def learn(self, corruption: str, seconds: float) -> None:
        """Record that preparing a cell's frames took `seconds`."""
        known = self._cost.get(corruption)
        self._cost[corruption] = seconds if known is None else 0.5 * (known + seconds)

    def finish(self, cell: Cell, row: dict[str, Any], seconds: dict[str, float]) -> FinishedUnit | None:
        """Accept the row of a cell and its cost, and return the unit if this was its last row."""
        key, corruption, severity = cell
        if corruption == CLEAN:
            self._blocked.discard(key)
        part = self._open[key, corruption]
        part.rows[severity] = row
        for kind, spent in seconds.items():
            part.seconds[kind] = part.seconds.get(kind, 0.0) + spent
        if len(part.rows) < len(part.unit.severities):
            return None
        del self._open[key, corruption]
        return FinishedUnit(part.unit, [part.rows[severity] for severity in part.unit.severities], part.seconds)

    def _begin(self, key: str) -> None:
        units = self._waiting.pop(key)
        self._open |= {(key, unit.corruption): _Open(unit) for unit in units}
        self._cells[key] = [cell for unit in units for cell in unit.cells]
        if units[0].corruption == CLEAN:
            self._blocked.add(key)

    def _choice(self, cells: list[Cell], has_backlog: bool) -> int:
        """Return the index of the next cell: the clean cell if it has not been assigned; with a backlog, the last cell
        of unknown cost, or the costliest; otherwise the cheapest cell of known cost, or the first."""
        if cells[0][1] == CLEAN:
            return 0
        costs = [self._cost.get(corruption) for _, corruption, _ in cells]
        known = [(cost, place) for place, cost in enumerate(costs) if cost is not None]
        if has_backlog:
            unknown = [place for place, cost in enumerate(costs) if cost is None]
            if unknown:
                last = cells[unknown[-1]][1]
                return next(place for place in unknown if cells[place][1] == last)
            return max(known, key=lambda entry: (entry[0], -entry[1]))[1]
        return min(known)[1] if known else 0
