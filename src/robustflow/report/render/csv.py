"""CSV: one line per model, for spreadsheets; marks and notes in separate columns."""

from __future__ import annotations

import csv
import io

from ...text import text_cell
from ..table import Column, Table


def render(table: Table) -> str:
    """The table as CSV with a header: section, the line's name, one column each, best (separated by "; "), note."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    headings = [_heading(column) for column in table.columns]
    writer.writerow(["section", text_cell(table.row_header.lower()), *headings, "best", "note"])
    for section in table.sections:
        for line in section.lines:
            best = "; ".join(h for h, cell in zip(headings, line.cells, strict=True) if cell.best)
            cells = ["" if cell.text == "-" else _value(cell.text) for cell in line.cells]
            writer.writerow([text_cell(section.title), text_cell(line.label), *cells, best, text_cell(line.note)])
    return out.getvalue()


def _value(text: str) -> str:
    try:
        float(text)
    except ValueError:
        return text_cell(text)
    return text


def _heading(column: Column) -> str:
    return text_cell(f"{column.group} {column.label}" if column.group else column.label)
