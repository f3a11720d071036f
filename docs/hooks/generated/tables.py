"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format heading and rows; None is an empty cell, and bars in a text are escaped."""
    lines = [_line(heading), "|" + "---|" * len(heading)]
    return "\n".join([*lines, *(_line(row) for row in rows)])


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join("" if c is None else " ".join(str(c).split()).replace("|", r"\|") for c in cells) + " |"
