"""What a page shows, as data, from which its script makes the leaderboard's rows, the pages of models and the
downloads.

A row of markup is many times the size of its numbers, and most rows and pages are never viewed. Every text from outside
is data here and becomes text in the browser, never markup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...analysis.labels import SETTING_EXPLANATIONS, SETTING_LABELS, benchmark_label, setting_words
from ...analysis.results import AVERAGE, CLEAN, RESULT_METRICS
from ...corruptions.names import MEMBERS, ordered
from ...text import plain
from ..table import Table, with_exclusion
from .board import Board
from .entries import LeaderboardEntry, NumberKey
from .models import ModelPage, interval_text


def page_data(boards: Sequence[Board], pages: Sequence[ModelPage]) -> dict[str, Any]:
    """The data of a page.

    Returns:
        `boards` in their order, `models` by the id of their page, `settings`: name -> (words, class of its chip, what
        it means), `labels`: the labels of the lines of shaded tables, which refer to them by number.
    """
    labels = {label: number for number, label in enumerate(_labels(pages))}
    settings = {entry.setting for board in boards for group in board.groups for entry in group.entries}
    return {
        "boards": [_board(board) for board in boards],
        "models": {page.id: _model(page, labels) for page in pages},
        "labels": list(labels),
        "settings": {
            name: (setting_words(name), _setting_class(name), SETTING_EXPLANATIONS.get(name, ""))
            for name in sorted(settings)
        },
    }


def _board(board: Board) -> dict[str, Any]:
    entries = [entry for group in board.groups for entry in group.entries]
    keys = _keys(entries)
    place = {key: index for index, key in enumerate(keys)}
    return {
        "benchmark": plain(board.benchmark),
        "numbers": [(metric, plain(corruption)) for metric, corruption in keys if _is_number(metric, corruption)],
        "columns": [place[column.key] for column in board.columns],
        "groups": [[_entry(entry, place, group.title) for entry in group.entries] for group in board.groups],
    }


def _keys(entries: Sequence[LeaderboardEntry]) -> list[NumberKey]:
    """First what a download holds, in its order; then means over classes of corruptions, which follow from the rest,
    and costs."""
    present = {key for entry in entries for key in entry.texts}
    corruptions = {corruption for _, corruption in present}
    order = [CLEAN, AVERAGE, *ordered(corruptions - {CLEAN, AVERAGE, *MEMBERS, ""})]
    numbers = [(metric, name) for metric in RESULT_METRICS for name in order if (metric, name) in present]
    return [*numbers, *sorted(present - set(numbers))]


def _is_number(metric: str, corruption: str) -> bool:
    return metric in RESULT_METRICS and corruption not in MEMBERS


def _entry(entry: LeaderboardEntry, place: dict[NumberKey, int], title: str) -> dict[str, Any]:
    """Only existing parts: most entries have no intervals, and many no note."""
    values: list[str | int] = [0] * len(place)
    for key, text in entry.texts.items():
        values[place[key]] = text
    shown = {
        "name": entry.model,
        "setting": entry.setting,
        "page": entry.page,
        "frames": plain(entry.line.frames, 200),
        "note": entry.note,
        "remark": _remark(entry, title),
        "excluded": bool(entry.line.excluded),
        "values": values,
        "best": sorted(place[key] for key in entry.best),
        "derived": sorted(place[key] for key in entry.derived),
        "intervals": {place[key]: interval_text(entry, key) for key in entry.intervals if key in place},
    }
    return {name: value for name, value in shown.items() if value or name in ("name", "setting")}


def _remark(entry: LeaderboardEntry, title: str) -> str:
    """Below the name: how it differs, unless the heading says so, and why it is not ranked."""
    return with_exclusion(plain(entry.note, 80) if entry.note not in title else "", plain(entry.line.excluded, 300))


def _model(page: ModelPage, labels: Mapping[str, int]) -> dict[str, Any]:
    tiles = [
        {
            "benchmark": benchmark_label(entry.line.benchmark),
            "setting": entry.setting,
            "note": entry.note,
            "scores": scores,
        }
        for entry, scores in page.tiles
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


def _labels(pages: Sequence[ModelPage]) -> list[str]:
    return list(dict.fromkeys(line.label for page in pages for table in page.tables for line in table.lines))


def _shaded_table(table: Table, labels: Mapping[str, int]) -> dict[str, Any]:
    """A line is the number of its label, its texts separated by spaces, and its intervals, if any."""
    lines = []
    for line in table.lines:
        intervals = [cell.interval for cell in line.cells]
        texts = " ".join(cell.text for cell in line.cells)
        lines.append((labels[line.label], texts, *([intervals] if any(intervals) else [])))
    columns = [column.label for column in table.columns]
    # The value of the strongest colour is only for the shade, not to be read.
    tops = [None if c.strongest is None else float(f"{c.strongest:.4g}") for c in table.columns]
    return {"title": table.title, "columns": columns, "tops": tops, "lines": lines}


def _plain_table(table: Table) -> dict[str, Any]:
    lines = [(line.label, [cell.text for cell in line.cells]) for line in table.lines]
    columns = [column.label for column in table.columns]
    return {"title": table.title, "columns": columns, "lines": lines, "remarks": table.remarks}


def _setting_class(setting: str) -> str:
    return f"set-{setting.lower()}" if setting in SETTING_LABELS else "set-other"
