"""Numbered footnotes, where identical notes share a number."""

from __future__ import annotations

from ...text import plain
from ..table import Table


def numbered_notes(table: Table) -> dict[str, int]:
    """Map each note to a number, starting at 1, in the order of the rows.

    >>> from robustflow.report.table import Line, Section
    >>> lines = (Line("a", (), "3 pairs"), Line("b", ()), Line("c", (), "3 pairs"))
    >>> numbered_notes(Table("x", "t", (), (Section("s", lines),)))
    {'3 pairs': 1}
    """
    notes = dict.fromkeys(line.note for line in table.lines if line.note)
    return {note: number for number, note in enumerate(notes, 1)}


def note_text(note: str) -> str:
    """Return a note as one printable line."""
    return plain(note, 300)
