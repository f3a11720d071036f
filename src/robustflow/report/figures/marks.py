"""What each mark of a figure means, so that a page can name it and find its model elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from .files import figure_bytes


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
    """A figure that knows what its marks mean.

    Attributes:
        marks: id of an artist in the SVG -> its marks, in the order they are drawn.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.marks: dict[str, tuple[Mark, ...]] = {}

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
