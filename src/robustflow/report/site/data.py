"""JSON data of a page, from which its script builds the leaderboard rows, the model pages and the downloads.

The markup of a row is many times larger than its data, and most rows and model pages are never viewed. Untrusted text
is passed as data and becomes text in the browser, never markup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...core.text import plain
from ...corruptions.registry import MEMBERS, ordered
from ...stats.model_result import ModelResult, ValueKey
from ...stats.results import (
    AVERAGE,
    CLEAN,
    RESULT_METRICS,
    SETTING_EXPLANATIONS,
    SETTING_LABELS,
    benchmark_label,
    setting_words,
)
from ..leaderboard import Board
from ..table import Table, TableCell, with_exclusion
from .content import Content
from .models import ModelPage


def page_data(content: Content, pages: Sequence[ModelPage]) -> dict[str, Any]:
    """Build the data of a page."""
    every_label = (line.label for page in pages for table in page.tables for line in table.lines)
    labels = {label: number for number, label in enumerate(dict.fromkeys(every_label))}
    settings = {name for board in content.boards for name, _, _ in board.settings}
    return {
        "boards": [_board(board, content.pages) for board in content.boards],
        "models": {page.id: _model(page, labels) for page in pages},
        "labels": list(labels),
        "settings": {
            name: (setting_words(name), _setting_class(name), SETTING_EXPLANATIONS.get(name, ""))
            for name in sorted(settings)
        },
    }


def _board(board: Board, page_of: Mapping[ModelResult, str]) -> dict[str, Any]:
    place = {key: index for index, key in enumerate(_keys(board))}
    return {
        "benchmark": plain(board.benchmark),
        "numbers": [(metric, plain(corruption)) for metric, corruption in place if _is_number(metric, corruption)],
        "columns": [place[column.key] for column in board.shown],
        "groups": [
            [
                _line(line.result, board.cells_of(line), place, section.title, page_of[line.result])
                for line in section.lines
                if line.result
            ]
            for section in board.sections
        ],
    }


def _keys(board: Board) -> list[ValueKey]:
    """Order the columns: those included in downloads first, then the costs and the means over corruption classes, which
    can be computed from other columns."""
    present = {column.key for column in board.columns}
    corruptions = {corruption for _, corruption in present}
    order = [CLEAN, AVERAGE, *ordered(corruptions - {CLEAN, AVERAGE, *MEMBERS, ""})]
    numbers = [(metric, name) for metric in RESULT_METRICS for name in order if (metric, name) in present]
    return [*numbers, *sorted(present - set(numbers))]


def _is_number(metric: str, corruption: str) -> bool:
    return metric in RESULT_METRICS and corruption not in MEMBERS


def _line(
    result: ModelResult, cells: Mapping[ValueKey, TableCell], place: Mapping[ValueKey, int], title: str, page: str
) -> dict[str, Any]:
    """Return the data of a line without empty fields: most lines have no intervals, and many have no note."""
    values: list[str | int] = [0] * len(place)
    for key, cell in cells.items():
        values[place[key]] = cell.text
    shown = {
        "name": plain(result.name),
        "setting": plain(result.setting, 40),
        "page": page,
        "frames": plain(result.frames, 200),
        "note": plain(result.note, 300),
        # text below the name: what the heading does not mention, and why the model is not ranked
        "remark": with_exclusion(_remark(result, title), plain(result.excluded, 300)),
        "source": result.source,
        "excluded": bool(result.excluded),
        "values": values,
        "best": sorted(place[key] for key, cell in cells.items() if cell.best),
        "derived": sorted(place[key] for key, cell in cells.items() if cell.derived),
        "intervals": {place[key]: cell.interval for key, cell in cells.items() if cell.interval},
    }
    return {name: value for name, value in shown.items() if value or name in ("name", "setting")}


def _remark(result: ModelResult, title: str) -> str:
    source = result.source if result.source == "verified record" else ""
    return "; ".join(filter(None, (source, plain(result.note, 80) if plain(result.note, 300) not in title else "")))


def _model(page: ModelPage, labels: Mapping[str, int]) -> dict[str, Any]:
    tiles = [
        {
            "benchmark": benchmark_label(line.benchmark),
            "setting": plain(line.setting, 40),
            "note": plain(line.note, 300),
            "scores": [(label, cell.text, cell.interval) for label, cell in scores],
        }
        for line, scores in page.tiles
        if scores
    ]
    return {
        "name": page.name,
        "tiles": tiles,
        "sentences": page.sentences,
        "tables": [_shaded_table(table, labels) for table in page.tables],
        "anatomy": None if page.anatomy is None else _plain_table(page.anatomy),
        "panels": [
            {
                "title": panel.title,
                "cell": (panel.corruption, str(panel.severity)),
                "numbers": panel.numbers,
                "picture": panel.picture,
                "size": (panel.width, panel.height),
            }
            for panel in page.panels
        ],
        "facts": page.facts,
    }


def _shaded_table(table: Table, labels: Mapping[str, int]) -> dict[str, Any]:
    """Encode each line as the index of its label, its texts separated by spaces, and its intervals, if any."""
    lines = []
    for line in table.lines:
        intervals = [cell.interval for cell in line.cells]
        texts = " ".join(cell.text for cell in line.cells)
        lines.append((labels[line.label], texts, *([intervals] if any(intervals) else [])))
    columns = [column.label for column in table.columns]
    # the value of the strongest colour is used only for shading
    tops = [None if c.strongest is None else float(f"{c.strongest:.4g}") for c in table.columns]
    return {"title": table.title, "columns": columns, "tops": tops, "lines": lines}


def _plain_table(table: Table) -> dict[str, Any]:
    lines = [(line.label, [cell.text for cell in line.cells]) for line in table.lines]
    columns = [column.label for column in table.columns]
    return {"title": table.title, "columns": columns, "lines": lines, "remarks": table.remarks}


def _setting_class(setting: str) -> str:
    return f"set-{setting.lower()}" if setting in SETTING_LABELS else "set-other"
