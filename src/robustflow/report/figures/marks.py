"""The meaning of each mark in a figure, so that a page can label it and link its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from .files import figure_bytes
from .styles import Style, legend_handles


@dataclass(frozen=True)
class Mark:
    """A point, bar or name in a figure.

    Attributes:
        model: the model it belongs to.
        setting: of the model, "" if the figure does not distinguish settings.
        values: (what, number with its unit), as the figure shows them; none for a name next to a point.
    """

    model: str
    setting: str = ""
    values: tuple[tuple[str, str], ...] = ()


class MarkedFigure(Figure):
    """A figure with the meaning of its marks.

    Attributes:
        marks: id of an artist in the SVG -> its marks, in the order they are drawn.
        caption: what is drawn, in sentences.
        key: what its colours and markers mean: (label, style, whether the marker is filled).
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.marks: dict[str, tuple[Mark, ...]] = {}
        self.caption = ""
        self.key: tuple[tuple[str, Style, bool], ...] = ()

    def explain(self, key: Sequence[tuple[str, Style, bool]], legend: bool) -> None:
        """Set the key, and draw it below the panels as a legend if wanted."""
        self.key = tuple(key)
        if legend and key:
            columns = max(1, min(len(key), int(self.get_figwidth() // 1.6)))
            self.legend(
                handles=legend_handles(key), loc="outside lower center", ncols=columns, frameon=False, fontsize=8
            )

    def _repr_png_(self) -> bytes:
        """The notebook's output, whatever backend it uses."""
        return figure_bytes(self, "png")

    def mark(self, artist: Artist, marks: Sequence[Mark]) -> None:
        """State what the points of an artist mean; one for a bar or a text.

        >>> figure = MarkedFigure()
        >>> figure.mark(figure.text(0, 0, "RAFT"), [Mark("RAFT")])
        >>> figure.marks
        {'mark-0': (Mark(model='RAFT', setting='', values=()),)}
        """
        name = f"mark-{len(self.marks)}"
        artist.set_gid(name)
        self.marks[name] = tuple(marks)
