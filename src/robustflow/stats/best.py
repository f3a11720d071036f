"""Find the best printed number in each column of a table or leaderboard."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Compared(Generic[Key]):
    """A line of printed numbers; lower is better."""

    group: Hashable
    texts: Mapping[Key, str]
    excluded: bool = False


def best_of_columns(lines: Sequence[Compared[Key]]) -> list[set[Key]]:
    """Return, for each line, the columns in which it has the smallest printed number. As in the paper, all lines with
    the same smallest printed number are marked; a line that is alone in its group is not marked.

    >>> lines = [Compared("OOD", {"epe": "4.20"}), Compared("OOD", {"epe": "4.2"}), Compared("ID", {"epe": "1.00"})]
    >>> best_of_columns(lines)
    [{'epe'}, {'epe'}, set()]
    """
    groups: dict[Hashable, list[Compared[Key]]] = {}
    for line in lines:
        if not line.excluded:
            groups.setdefault(line.group, []).append(line)
    least: dict[tuple[Hashable, Key], float] = {}
    for group, members in groups.items():
        if len(members) > 1:
            for line in members:
                for key, text in line.texts.items():
                    least[group, key] = min(float(text), least.get((group, key), float("inf")))
    return [
        set()
        if line.excluded
        else {key for key, text in line.texts.items() if least.get((line.group, key)) == float(text)}
        for line in lines
    ]
