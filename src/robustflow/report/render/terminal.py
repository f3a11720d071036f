"""Terminal output: a table that is too wide is split into blocks of columns, each with the model names."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Literal

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from ...core.text import plain
from ..table import LONGEST_NOTE, Column, Section, Table

_WIDTH = 120
_NAME = 60
_LEAST, _MOST = 10, _NAME + 5
"""Bounds on the width of the first column: names with the marks of their notes."""
_GROUP = 11


def render(table: Table, width: int = _WIDTH, colour: bool = False) -> str:
    """Render the table as text at most `width` characters wide; bold (or a star, without colour) marks the best value
    of a column."""
    out = io.StringIO()
    console = Console(
        file=out, width=width, force_terminal=colour, color_system="standard" if colour else None, highlight=False
    )
    console.print(Text(plain(table.title, None), style="bold"))
    if any(column.prose for column in table.columns):
        # In tables with prose, each section is a separate grid below its title, because titles and cells are long.
        for section in table.sections:
            console.print(Text(f"\n{plain(section.title, None)}", style="italic"))
            console.print(_grid(table, (section,), list(range(len(table.columns))), width, colour))
    else:
        for block in _blocks(table, width):
            console.print(_grid(table, table.sections, block, width, colour))
    for remark in table.remarks:
        console.print(Text(plain(remark, None)))
    if not colour and any(cell.best for line in table.lines for cell in line.cells):
        console.print("* best")
    for note, number in table.notes.items():
        console.print(Text(f"[{number}] {plain(note, LONGEST_NOTE)}"))
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def _needs(table: Table) -> list[int]:
    """Return the width of each column with its separator and the star of its best cell; 0 for prose, which wraps."""
    needs = []
    for index, column in enumerate(table.columns):
        widths = [cell_len(part) for part in _heading(column).split("\n")]
        widths += [cell_len(plain(line.cells[index].text, None)) + line.cells[index].best for line in table.lines]
        needs.append(0 if column.prose else 3 + max(widths))
    return needs


def _firsts(table: Table, sections: Sequence[Section], width: int) -> list[str]:
    """Return the texts of the first column in order, including the titles of sections. They are truncated to leave room
    for any other column, because a truncated number would look like a different number."""
    notes, longest = table.notes, max(_LEAST, min(_MOST, width - max(_needs(table), default=0)))
    firsts = []
    for section in sections:
        firsts.append(_fitted(plain(section.title), "", longest))
        for line in section.lines:
            mark = f" [{notes[line.note]}]" if line.note else ""
            firsts.append(_fitted(plain(line.label, _NAME), mark, longest))
    return firsts


def _fitted(name: str, mark: str, longest: int) -> str:
    room = longest - len(mark)
    return (name if cell_len(name) <= room else f"{set_cell_size(name, room - 1).rstrip()}…") + mark


def _blocks(table: Table, width: int) -> list[list[int]]:
    """Return the column indices of each block."""
    room = width - max(map(cell_len, [plain(table.row_header), *_firsts(table, table.sections, width)]))
    blocks: list[list[int]] = [[]]
    used = 0
    for index, need in enumerate(_needs(table)):
        if blocks[-1] and used + need > room:
            blocks.append([])
            used = 0
        blocks[-1].append(index)
        used += need
    return blocks


def _grid(table: Table, sections: tuple[Section, ...], block: list[int], width: int, colour: bool) -> RichTable:
    firsts = iter(_firsts(table, sections, width))
    grid = RichTable(show_edge=False, pad_edge=False)
    grid.add_column(Text(plain(table.row_header)), no_wrap=True)
    for index in block:
        column = table.columns[index]
        justify: Literal["left", "right"] = "left" if column.prose else "right"
        # a URL that is too long for its column continues on the next line, because a truncated URL is useless
        grid.add_column(Text(_heading(column)), justify=justify, no_wrap=not column.prose, overflow="fold")
    for section in sections:
        title = Text(next(firsts), style="italic")
        if sections is table.sections and section.title:
            grid.add_row(title)
        for line in section.lines:
            texts = [Text(next(firsts))]
            for index in block:
                cell = line.cells[index]
                star = "*" if cell.best and not colour else ""
                texts.append(Text(plain(cell.text, None) + star, style="bold" if cell.best else ""))
            grid.add_row(*texts)
        grid.add_section()
    return grid


def _heading(column: Column) -> str:
    """Return the heading as two lines: the group, truncated to the column width, and the label."""
    group = plain(column.group)
    group = group if len(group) <= _GROUP else f"{group[: _GROUP // 2]}."
    return f"{group}\n{plain(column.label)}" if group else plain(column.label)
