"""Tables as data: columns, lines in sections, and the content of each cell. A renderer per medium prints them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Any, NamedTuple

import polars as pl

from ..core.errors import UsageError
from ..core.text import plain
from ..run.comparable import differences
from ..run.run import Run
from ..stats.frame import DERIVED, results_frame
from ..stats.lines import LineKey, Lines, Numbers, lines_of, number_of
from ..stats.lines import Row as FrameRow
from ..stats.published.tables import published_frame
from ..stats.results import AVERAGE
from ..stats.seeds import with_seeds

DASH = "-"
"""Text of a cell without a number."""

LONGEST_NOTE = 600
"""Maximum number of characters of a printed note."""


@dataclass(frozen=True)
class Column:
    """A column of a table, with the format of its numbers and the key of what it shows, for example (measure,
    condition, severity). Pages use the last four: an explanation, the unit, the views that show the column, and the
    value of the strongest shade."""

    label: str
    format: str = "{:.2f}"
    group: str = ""
    prose: bool = False
    key: tuple[Any, ...] = ("", "", None)
    help: str = ""
    unit: str = ""
    views: Sequence[str] = ()
    strongest: float | None = None


@dataclass(frozen=True)
class TableCell:
    """A cell of a table."""

    text: str
    best: bool = False
    interval: str = ""
    derived: bool = False

    @property
    def marked(self) -> TableCell:
        """The cell with a dagger if its value is derived, for media that do not mark it otherwise."""
        return replace(self, text=f"{self.text}†") if self.derived else self


class Row(NamedTuple):
    """What a line is made from: numbers to be written in the formats of their columns, texts, cells, and None for what
    is missing. `best` shades the line; `result` is what it shows."""

    label: str
    values: Iterable[float | str | TableCell | None]
    note: str = ""
    best: bool = False
    result: LineKey | None = None


@dataclass(frozen=True)
class Line:
    """A line of a table."""

    label: str
    cells: tuple[TableCell, ...]
    note: str = ""
    best: bool = False
    result: LineKey | None = None

    @classmethod
    def of(cls, row: Row, columns: Sequence[Column]) -> Line:
        """Write the values of a row.

        >>> [cell.text for cell in Line.of(Row("RAFT", [1.23456, None, "OOD"]), [Column("EPE")] * 3).cells]
        ['1.23', '-', 'OOD']
        """
        cells = (
            value if isinstance(value, TableCell) else TableCell(number_text(value, column.format))
            for value, column in zip(row.values, columns, strict=True)
        )
        return cls(row.label, tuple(cells), row.note, row.best, row.result)


@dataclass(frozen=True)
class Section:
    """A section of a table: the models of one setting, or other lines with a heading; "" for no heading."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Table:
    """A table. Its texts may come from files; renderers escape them."""

    name: str
    title: str
    columns: tuple[Column, ...]
    sections: tuple[Section, ...]
    remarks: tuple[str, ...] = ()
    row_header: str = "Model"

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        columns: Iterable[str | Column],
        rows: Mapping[str, Iterable[Row | tuple[Any, ...]]],
        remarks: Iterable[str] = (),
        row_header: str = "Model",
        keep_empty: bool = False,
    ) -> Table:
        """Make a table from columns (or their labels) and rows by the title of their section, without empty sections
        and, unless they are kept, empty columns.

        >>> table = Table.of("means", "Means", ("CRE", "RCRE"), {"Runs": [("dis", [None, 2.92])], "Published": []})
        >>> [column.label for column in table.columns], [section.title for section in table.sections]
        (['RCRE'], ['Runs'])
        """
        known = tuple(column if isinstance(column, Column) else Column(column) for column in columns)
        lines = {heading: tuple(Line.of(Row(*row), known) for row in of) for heading, of in rows.items()}
        sections = tuple(Section(heading, of) for heading, of in lines.items() if of)
        table = cls(name, title, known, sections, tuple(filter(None, remarks)), row_header)
        return table if keep_empty else table.without_empty_columns()

    @property
    def lines(self) -> list[Line]:
        """Return the lines of all sections."""
        return [line for section in self.sections for line in section.lines]

    @property
    def notes(self) -> dict[str, int]:
        """The notes on the lines, each with its number, from 1; lines with equal notes share a number."""
        notes = dict.fromkeys(line.note for line in self.lines if line.note)
        return {note: number for number, note in enumerate(notes, 1)}

    def with_shared_notes(self) -> Table:
        """Return the table with what every line's note says as its first remark, and no longer on the lines.

        >>> rows = [("dis", ["1"], "6 pairs"), ("tiny", ["2"], "6 pairs; not ranked: its weights")]
        >>> table = Table.of("means", "Means", ("EPE",), {"Runs": rows}).with_shared_notes()
        >>> table.remarks, [line.note for line in table.lines]
        (('6 pairs.',), ['', 'not ranked: its weights'])
        """
        notes = [line.note.split("; ") for line in self.lines]
        shared = [part for part in (notes[0] if notes else []) if part and all(part in note for note in notes)]
        if not shared:
            return self

        def rest(line: Line) -> Line:
            return replace(line, note="; ".join(part for part in line.note.split("; ") if part not in shared))

        sections = tuple(replace(section, lines=(*map(rest, section.lines),)) for section in self.sections)
        remark = plain(f"{'; '.join(shared)}.", LONGEST_NOTE)
        return replace(self, sections=sections, remarks=(remark, *self.remarks))

    def without_empty_columns(self) -> Table:
        """Return the table without columns that contain only dashes."""
        filled = [any(line.cells[place].text != DASH for line in self.lines) for place in range(len(self.columns))]
        sections = tuple(
            replace(
                section, lines=tuple(replace(line, cells=(*compress(line.cells, filled),)) for line in section.lines)
            )
            for section in self.sections
        )
        return replace(self, columns=(*compress(self.columns, filled),), sections=sections)


def with_exclusion(note: str, reason: str) -> str:
    """Return the note on a line, including the reason if its model is not ranked.

    >>> with_exclusion("3 pairs", "its weights are random")
    '3 pairs; not ranked: its weights are random'
    """
    return "; ".join(part for part in (note, reason and f"not ranked: {reason}") if part)


def full_note(numbers: Numbers) -> str:
    """Return the note on a line of results in a table without a column for the coverage: what was measured, the
    share of the pixels that its errors cover if not all, and the reason if it is not ranked."""
    share = "" if numbers.coverage is None else f"errors cover {100 * numbers.coverage:.1f} % of the pixels"
    return with_exclusion("; ".join(filter(None, (numbers.fact("note"), share))), numbers.fact("excluded"))


def differences_remark(runs: Mapping[str, Run]) -> str:
    """Return the remark below a table of runs that measured different conditions; "" if they did not."""
    words = differences(runs) if len(runs) > 1 else ""
    return f"The runs differ: {words}." if words else ""


def cell_of(row: FrameRow, format: str = "{:.2f}", *, with_interval: bool = False) -> TableCell:
    """Return the cell of a number of the frame, with as many decimals as printed, else in a format. With
    `with_interval`, the interval is part of the text, not only shown by media that have room for it."""
    text = number_text(row["value"], format) if row["decimals"] is None else number_of(row)
    if row["deviation"] is not None:
        text = f"{text} ± {row['deviation']:.2f}"
    interval = interval_text(None if row["low"] is None else (row["low"], row["high"]))
    if with_interval:
        return TableCell(f"{text} {interval}".rstrip())
    derived = row["origin"] == DERIVED and row["condition"] == AVERAGE and row["source"] == "published"
    return TableCell(text, interval=interval, derived=derived)


def model_rows(lines: Lines, columns: Sequence[Column], *, with_interval: bool = False) -> list[Row]:
    """Return a row for each line of results, with the number of each column's key."""

    def cell(numbers: Numbers, column: Column) -> TableCell | None:
        row = numbers.get(column.key)
        return None if row is None else cell_of(row, column.format, with_interval=with_interval)

    return [
        Row(key.model, [cell(numbers, column) for column in columns], full_note(numbers), result=key)
        for key, numbers in lines.items()
    ]


Condition = tuple[str, int | None]
"""(condition, severity); None for the mean over severities."""


def condition_rows(numbers: Numbers, columns: Sequence[Column], rows: Mapping[str, Condition]) -> list[Row]:
    """Return a row for each condition of one line, by label; the keys of the columns are (measure, severity). Only
    means over severities have their intervals."""

    def cell(column: Column, of: str, at: int | None) -> TableCell | None:
        measure, severity = column.key
        row = numbers.get((measure, of, at or severity))
        if row is None:
            return None
        shown = cell_of(row, column.format)
        return shown if row["severity"] is None else replace(shown, interval="")

    return [Row(label, [cell(column, of, at) for column in columns]) for label, (of, at) in rows.items()]


def interval_text(ends: tuple[float, float] | None) -> str:
    """Format the bounds of an interval; "" if there is none. With few clusters, the upper bound of CREr can have a
    hundred digits.

    >>> interval_text((1.024, 1.7)), interval_text((-1.0, 1.431e110)), interval_text(None)
    ('[1.02, 1.70]', '[-1.00, 1.4e+110]', '')
    """
    if ends is None:
        return ""
    low, high = (f"{end:.2f}" if abs(end) < 1e6 else f"{end:.1e}" for end in ends)
    return f"[{low}, {high}]"


def number_text(value: float | str | None, format: str = "{:.2f}") -> str:
    """Format a number, with two decimals by default; a dash if there is none. Texts stay as they are."""
    if value is None:
        return DASH
    return value if isinstance(value, str) else format.format(value)


@dataclass(frozen=True)
class Wanted:
    """What tables are made from: the results frame of runs and, if wanted, of the published results."""

    runs: Sequence[Run]
    published: bool

    @cached_property
    def frame(self) -> pl.DataFrame:
        """The published results, if wanted, followed by those of the runs and of seeds."""
        frames = [published_frame()] * self.published
        return pl.concat([*frames, with_seeds(run_frame(self.runs, self.published), self.runs)])

    @cached_property
    def lines(self) -> Lines:
        """The lines of the frame."""
        return lines_of(self.frame)

    def of_runs(self, table: str, *kinds: str, intervals: bool = False, seeds: bool = False) -> Lines:
        """Return only the lines of runs, for a table that needs some; with `seeds`, also those of means over seeds."""
        if not self.runs:
            raise UsageError("--table", f"'{table}' requires runs: give at least one run")
        frame = results_frame(self.runs, ("means", *kinds), intervals=intervals, detailed=False)
        return lines_of(with_seeds(frame, self.runs) if seeds else frame)


def run_frame(runs: Sequence[Run], beside_published: bool = False, *, intervals: bool = False) -> pl.DataFrame:
    """Return the means of runs and the cost of their models."""
    return results_frame(runs, ("means", "facts"), intervals=intervals, beside_published=beside_published)


def without_seeds(lines: Lines) -> Lines:
    """Return the lines of models, without means over seeds."""
    return {key: numbers for key, numbers in lines.items() if numbers.fact("source") != "seeds"}
