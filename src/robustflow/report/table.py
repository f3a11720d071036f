"""A table as data: the contents of each cell, and which is the best of its column."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from statistics import mean, stdev

from ..analysis.model_result import ModelResult, Value

DASH = "-"
"""The text of a cell without a number."""


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes:
        label: its heading.
        group: the heading over it that neighbours share; "" for none.
        prose: whether it holds sentences, which run over several lines.
        strongest: the value of the strongest colour, where a page shades cells by their values; None for no shade.
    """

    label: str
    group: str = ""
    prose: bool = False
    strongest: float | None = None


@dataclass(frozen=True)
class TableCell:
    """The text of a cell.

    Attributes:
        text: what is printed.
        best: whether it is the smallest of its column among the lines it can be compared with.
        interval: what a page prints small beside it.
        derived: whether the number is computed from others where its source prints none; a page sets it in italics.
    """

    text: str
    best: bool = False
    interval: str = ""
    derived: bool = False


@dataclass(frozen=True)
class Line:
    """A model.

    Attributes:
        label: its name.
        cells: one a column.
        note: how it differs from the paper's measurement; "" if not at all.
        best: whether the line as a whole is the recommended choice, as the paper shades the lines of the best average
            rank.
        result: whose numbers the cells are, for what a page shows beside them.
    """

    label: str
    cells: tuple[TableCell, ...]
    note: str = ""
    best: bool = False
    result: ModelResult | None = None

    @classmethod
    def of(cls, label: str, texts: Iterable[str], note: str = "") -> Line:
        """A line of texts, none of which is marked."""
        return cls(label, tuple(map(TableCell, texts)), note)

    @classmethod
    def of_numbers(cls, label: str, numbers: Iterable[float | None], note: str = "") -> Line:
        """A line of numbers with two decimals, none of which is marked.

        >>> [cell.text for cell in Line.of_numbers("RAFT", [1.23456, None]).cells]
        ['1.23', '-']
        """
        return cls.of(label, map(number_text, numbers), note)


@dataclass(frozen=True)
class Section:
    """The models of one setting."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Table:
    """A table; every text in it may come from a file and is escaped by the renderers.

    Attributes:
        name: one of `tables.TABLES`, or the name of its source.
        title: what it shows, in words.
        columns: all but the first, which names the lines.
        sections: in the paper's order.
        remarks: sentences below it.
        row_header: the heading of the first column.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    sections: tuple[Section, ...]
    remarks: tuple[str, ...] = ()
    row_header: str = "Model"

    @property
    def lines(self) -> list[Line]:
        """The lines of all sections."""
        return [line for section in self.sections for line in section.lines]

    def without_empty_columns(self) -> Table:
        """The table without the columns that have a dash in every line.

        >>> lines = (Line("dis", (TableCell("-"), TableCell("2.92"))), Line("tiny", (TableCell("-"), TableCell("-"))))
        >>> table = Table("means", "Means", (Column("CRE"), Column("RCRE")), (Section("Runs", lines),))
        >>> [column.label for column in table.without_empty_columns().columns]
        ['RCRE']
        """
        filled = [any(line.cells[place].text != DASH for line in self.lines) for place in range(len(self.columns))]
        sections = tuple(
            replace(
                section, lines=tuple(replace(line, cells=(*compress(line.cells, filled),)) for line in section.lines)
            )
            for section in self.sections
        )
        return replace(self, columns=(*compress(self.columns, filled),), sections=sections)


def with_exclusion(note: str, reason: str) -> str:
    """The note of a line, and why its model is not ranked.

    >>> with_exclusion("3 pairs", "its weights are random")
    '3 pairs; not ranked: its weights are random'
    """
    return "; ".join(part for part in (note, reason and f"not ranked: {reason}") if part)


def spread_text(values: Sequence[float | None]) -> str:
    """The mean of two or more values and their standard deviation; a dash where one is missing.

    >>> spread_text([1.0, 2.0, 3.0]), spread_text([1.0, None])
    ('2.00 ± 1.00', '-')
    """
    known = [value for value in values if value is not None]
    return DASH if len(known) < len(values) else f"{mean(known):.2f} ± {stdev(known):.2f}"


def interval_text(ends: tuple[float, float] | None) -> str:
    """The ends of an interval; "" if there is none.

    >>> interval_text((1.024, 1.7)), interval_text(None)
    ('[1.02, 1.70]', '')
    """
    return "" if ends is None else f"[{ends[0]:.2f}, {ends[1]:.2f}]"


def number_text(value: float | None, decimals: int | None = None) -> str:
    """A number as it was printed, or with two decimals.

    >>> number_text(4.2, 2), number_text(1.23456), number_text(None)
    ('4.20', '1.23', '-')
    """
    return DASH if value is None else Value(value, decimals).text
