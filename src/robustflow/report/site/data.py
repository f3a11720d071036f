"""JSON data of a page, from which its script builds the leaderboards, the model pages and the downloads.

The markup of a row is many times larger than its data, and most rows and model pages are never viewed. Untrusted text
is passed as data and becomes text in the browser, never markup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ...core.text import plain
from ...corruptions.registry import MEMBERS
from ...stats.lines import LineKey, Numbers
from ...stats.results import (
    FAMILY_LABELS,
    METRIC_LABELS,
    RESULT_METRICS,
    SETTING_EXPLANATIONS,
    SETTING_LABELS,
)
from ..leaderboard import CLASSES, COMPACT, OVERVIEW, START
from ..table import Column, Line, Table, with_exclusion
from .content import Content
from .examples import PanelPicture
from .models import model_pages

_VIEWS = {OVERVIEW: "Overview", COMPACT: "Compact", CLASSES: "Class means", **FAMILY_LABELS}


def page_data(content: Content, panels: Mapping[LineKey, Sequence[PanelPicture]]) -> dict[str, Any]:
    """Build the data of a page."""
    pictures = {content.pages[line]: [asdict(panel) for panel in of_line] for line, of_line in panels.items()}
    settings = [setting for board in content.boards for setting in settings_of(board)]
    return {
        "boards": [_board(board, content) for board in content.boards],
        "models": {
            page: {"name": name, "tables": list(map(_table, tables)), "panels": pictures.get(page, [])}
            for page, (name, tables) in model_pages(content).items()
        },
        "settings": {
            name: (name, f"set-{name.lower()}" if name in SETTING_LABELS else "set-other", explanation)
            for name, explanation in settings
        },
        "views": _VIEWS,
        "metrics": METRIC_LABELS,
    }


def settings_of(board: Table) -> list[tuple[str, str]]:
    """Return the settings of a board's lines in order, each with its explanation, if it has one."""
    here = {plain(line.result.setting, 40) for line in board.lines if line.result}
    order = [*SETTING_LABELS, *sorted(here - set(SETTING_LABELS))]
    return [(name, SETTING_EXPLANATIONS.get(name, "")) for name in order if name in here]


def _board(board: Table, content: Content) -> dict[str, Any]:
    keys = [column.key for column in board.columns]
    data = _table(board)
    for section, made in zip(board.sections, data["sections"], strict=True):
        for line, entry in zip(section.lines, made["lines"], strict=True):
            if line.result is not None:
                of_line = content.lines[line.result]
                entry |= _facts(line.result, of_line, section.title) | {"page": content.pages[line.result]}
    return data | {
        "name": plain(board.name),
        "start": next((index for key in START for index, known in enumerate(keys) if known == key), 0),
        "exported": [
            (index, metric, plain(condition))
            for index, (metric, condition, _) in enumerate(keys)
            if metric in RESULT_METRICS and condition not in MEMBERS and keys.index(keys[index]) == index
        ],
    }


def _facts(key: LineKey, numbers: Numbers, title: str) -> dict[str, Any]:
    """Return what a board shows and exports about a line besides its numbers."""
    source, noted, excluded = (str(numbers.fact(name)) for name in ("source", "note", "excluded"))
    note = plain(noted, 80) if plain(noted, 300) not in title else ""
    remark = "; ".join(filter(None, (source if source == "verified record" else "", note)))
    return _known(
        setting=plain(key.setting, 40),
        frames=plain(key.sample_set, 200),
        note=plain(noted, 300),
        remark=with_exclusion(remark, plain(excluded, 300)),
        source=source,
        excluded=bool(excluded),
    )


def _known(**fields: Any) -> dict[str, Any]:
    """Return the fields that have a value; the page's script has defaults for the others."""
    return {name: value for name, value in fields.items() if value}


def _table(table: Table) -> dict[str, Any]:
    return {
        "kind": table.name,
        "title": table.title,
        "head": table.row_header,
        "columns": list(map(_column, table.columns)),
        "sections": [{"title": section.title, "lines": list(map(_line, section.lines))} for section in table.sections],
        "remarks": table.remarks,
    }


def _column(column: Column) -> dict[str, Any]:
    metric, top = column.key[0] if column.views else "", float(f"{column.strongest or 0:.4g}")
    return {"label": column.label} | _known(
        help=column.help, unit=column.unit, views=column.views, metric=metric, top=top
    )


def _line(line: Line) -> dict[str, Any]:
    """Encode a line as its name, its texts separated by tabs, and the indices of marked cells."""
    cells = list(enumerate(line.cells))
    return {"name": plain(line.label), "texts": "\t".join(cell.text for cell in line.cells)} | _known(
        note=plain(line.note, 300),
        best=[index for index, cell in cells if cell.best],
        derived=[index for index, cell in cells if cell.derived],
        intervals={index: cell.interval for index, cell in cells if cell.interval},
    )
