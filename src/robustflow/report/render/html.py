"""HTML output: one `<table>` inside a `<figure>`, without style or script; `b` marks the best value of a column."""

from __future__ import annotations

from html import escape as escape_html
from itertools import groupby

from ...core.text import plain
from ..table import LONGEST_NOTE, Table, TableCell


def render(table: Table) -> str:
    """Render the table as an HTML fragment. All text is escaped, and attributes contain only constants."""
    notes = table.notes
    caption = f"<figcaption>{escape(table.title)}</figcaption>" if table.title else ""
    lines = [f'<figure class="results">{caption}', "<table>", "<thead>"]
    groups = [(group, len(list(columns))) for group, columns in groupby(table.columns, lambda column: column.group)]
    if any(group for group, _ in groups):
        over = "".join(
            f'<th scope="colgroup" colspan="{count}">{escape(group)}</th>' if group else f'<td colspan="{count}"></td>'
            for group, count in groups
        )
        lines.append(f"<tr><td></td>{over}</tr>")
    headings = "".join(f'<th scope="col">{escape(column.label)}</th>' for column in table.columns)
    lines += [f'<tr><th scope="col">{escape(table.row_header)}</th>{headings}</tr>', "</thead>"]
    for section in table.sections:
        span = len(table.columns) + 1
        lines.append("<tbody>")
        if section.title:
            lines.append(f'<tr><th scope="rowgroup" colspan="{span}">{escape(section.title)}</th></tr>')
        for line in section.lines:
            mark = f" <sup>{notes[line.note]}</sup>" if line.note else ""
            cells = "".join(map(_cell, line.cells))
            lines.append(f'<tr><th scope="row">{escape(line.label)}{mark}</th>{cells}</tr>')
        lines.append("</tbody>")
    lines.append("</table>")
    lines += [f"<p>{escape(remark, None)}</p>" for remark in table.remarks]
    lines += [f"<p><sup>{number}</sup> {escape(note, LONGEST_NOTE)}</p>" for note, number in notes.items()]
    return "\n".join([*lines, "</figure>"]) + "\n"


def escape(text: str, longest: int | None = 80) -> str:
    """Escape text for HTML elements and quoted attributes."""
    return escape_html(plain(text, longest), quote=True)


def _cell(cell: TableCell) -> str:
    text = escape(cell.text, None)
    return f"<td><b>{text}</b></td>" if cell.best else f"<td>{text}</td>"
