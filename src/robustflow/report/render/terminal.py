"""Terminal output: a table that is too wide is split into blocks of columns, each with the model names."""

from __future__ import annotations

import io
from typing import Literal

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from ...text import plain
from ..table import LONGEST_NOTE, Column, Section, Table

_WIDTH = 120
_NAME = 60
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
            console.print(_grid(table, (section,), list(range(len(table.columns))), colour))
    else:
        for block in _blocks(table, width):
            console.print(_grid(table, table.sections, block, colour))
    for remark in table.remarks:
        console.print(Text(plain(remark, None)))
    if not colour and any(cell.best for line in table.lines for cell in line.cells):
        console.print("* best")
    for note, number in table.notes.items():
        console.print(Text(f"[{number}] {plain(note, LONGEST_NOTE)}"))
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def _blocks(table: Table, width: int) -> list[list[int]]:
    """Return the column indices of each block."""
    names = [plain(line.label, _NAME) for line in table.lines]
    room = width - max(map(len, names), default=0) - 6
    blocks: list[list[int]] = [[]]
    used = 0
    for index, column in enumerate(table.columns):
        if column.prose:
            blocks[-1].append(index)
            continue
        texts = [line.cells[index].text for line in table.lines]
        need = max(map(len, [*texts, *_heading(column).split("\n")])) + 3
        if blocks[-1] and used + need > room:
            blocks.append([])
            used = 0
        blocks[-1].append(index)
        used += need
    return blocks


def _grid(table: Table, sections: tuple[Section, ...], block: list[int], colour: bool) -> RichTable:
    notes = table.notes
    grid = RichTable(show_edge=False, pad_edge=False)
    grid.add_column(Text(plain(table.row_header)), no_wrap=True)
    for index in block:
        column = table.columns[index]
        justify: Literal["left", "right"] = "left" if column.prose else "right"
        # a URL that is too long for its column continues on the next line, because a truncated URL is useless
        grid.add_column(Text(_heading(column)), justify=justify, no_wrap=not column.prose, overflow="fold")
    for section in sections:
        if sections is table.sections:
            grid.add_row(Text(plain(section.title), style="italic"))
        for line in section.lines:
            mark = f" [{notes[line.note]}]" if line.note else ""
            texts = [Text(plain(line.label, _NAME) + mark)]
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
