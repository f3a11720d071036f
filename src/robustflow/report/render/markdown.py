"""GitHub-flavoured Markdown output: the best value of a column in bold, notes below the table."""

from __future__ import annotations

from collections.abc import Iterable

from ...core.text import plain
from ..table import LONGEST_NOTE, Table, TableCell

_SPECIAL = str.maketrans({c: f"\\{c}" for c in "\\`*_{}[]#|~$!"} | {"<": "&lt;", ">": "&gt;", "&": "&amp;"})


def render(table: Table) -> str:
    """Render the table as a Markdown section."""
    notes = table.notes
    headings = [table.row_header, *(f"{column.group} {column.label}".strip() for column in table.columns)]
    lines = [_row(map(escape, headings)), _row([":--", *["--:"] * len(table.columns)])]
    for section in table.sections:
        if section.title:
            lines.append(_row([f"*{escape(section.title)}*", *[""] * len(table.columns)]))
        for line in section.lines:
            mark = f" <sup>{notes[line.note]}</sup>" if line.note else ""
            lines.append(_row([escape(line.label) + mark, *map(_cell, line.cells)]))
    remarks = [escape(plain(remark, None)) for remark in table.remarks]
    remarks += [f"<sup>{number}</sup> {escape(plain(note, LONGEST_NOTE))}" for note, number in notes.items()]
    return "\n".join([f"### {escape(table.title)}", "", *lines, "", *(f"{remark}  " for remark in remarks)]) + "\n"


def escape(text: str) -> str:
    """Escape text for Markdown."""
    return plain(text, None).translate(_SPECIAL)


def _cell(cell: TableCell) -> str:
    text = escape(cell.text)
    return f"**{text}**" if cell.best else text


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
