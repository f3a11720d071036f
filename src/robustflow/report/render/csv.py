"""CSV output for spreadsheets: one line per model, with marks and notes in separate columns."""

from __future__ import annotations

import csv
import io

from ...core.text import text_cell
from ..table import Column, Table


def render(table: Table) -> str:
    """Render the table as CSV with a header: section, line label, the table's columns, best (separated by "; "), and
    note."""
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
