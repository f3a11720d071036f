"""Describe imported lines: the note on each of them, and the corruptions in an average."""

from __future__ import annotations

from collections.abc import Sequence

from ...text import counted

NOTE = "imported, not verifiable: no seed, no rows"
"""The note on every imported line."""


def averaged_over(names: Sequence[str], wanted: Sequence[str]) -> str:
    """Name the corruptions in an average, or those left out if these are fewer."""
    text = f"average over {counted(len(names), 'corruption')}"
    missing, further = [name for name in wanted if name not in names], [name for name in names if name not in wanted]
    if not missing and not further:
        return text
    if not further and len(missing) < len(names):
        return f"{text}, without {', '.join(missing)}"
    return f"{text}: {', '.join(names)}"
