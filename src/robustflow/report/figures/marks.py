"""Meaning of each mark in a figure, so that a page can label the mark and link it to its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from .files import figure_bytes
from .styles import KeyEntry, legend_handles


@dataclass(frozen=True)
class Mark:
    """A point, bar or name in a figure."""

    model: str
    setting: str = ""
    values: tuple[tuple[str, str], ...] = ()


class MarkedFigure(Figure):
    """A figure together with the meaning of its marks."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.marks: dict[str, tuple[Mark, ...]] = {}
        self.caption = ""
        self.key: tuple[KeyEntry, ...] = ()

    def explain(self, key: Sequence[KeyEntry], legend: bool) -> None:
        """Set the key and, if requested, draw it as a legend below the panels."""
        self.key = tuple(key)
        if legend and key:
            columns = max(1, min(len(key), int(self.get_figwidth() // 1.6)))
            self.legend(
                handles=legend_handles(key), loc="outside lower center", ncols=columns, frameon=False, fontsize=8
            )

    def _repr_png_(self) -> bytes:
        """Return the figure as a PNG for notebooks, regardless of the matplotlib backend."""
        return figure_bytes(self, "png")

    def mark(self, artist: Artist, marks: Sequence[Mark]) -> None:
        """Record the meaning of an artist's points; a bar or a text has a single mark."""
        name = f"mark-{len(self.marks)}"
        artist.set_gid(name)
        self.marks[name] = tuple(marks)
