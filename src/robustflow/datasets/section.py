"""A position in a clip: a frame number, or a time."""

from __future__ import annotations

import re

from ..errors import UsageError

Position = int | str | None
"""A frame number from 0, a time such as "12.5s" or "1:05" (minutes and seconds), or None for the beginning or end."""


def position(option: str, value: Position | float) -> int | float | None:
    """Parse a position into a frame number (int) or a time in seconds (float)."""
    if value is None or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    text = str(value).strip()
    if text.isascii() and text.isdigit():
        return int(text)
    if match := re.fullmatch(r"(\d{1,6}(?:\.\d+)?) ?s", text):
        return float(match[1])
    if match := re.fullmatch(r"(?:(\d{1,3}):)?(\d{1,3}):([0-5]?\d(?:\.\d+)?)", text):
        return 3600.0 * int(match[1] or 0) + 60.0 * int(match[2]) + float(match[3])
    raise UsageError(f"{option} cannot be {value!r}: give a frame number such as 120, or a time such as 12.5s or 1:05")
