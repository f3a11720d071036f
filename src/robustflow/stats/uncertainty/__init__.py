"""Uncertainty of means: bootstrap intervals, paired tests, and statements about differences.

`docs/design/uncertainty.md` explains the choice of methods and evaluates them.
"""

from __future__ import annotations

from .intervals import intervals
from .paired import compare_all, compare_rows, difference_sentence, group_letters, standings
from .variance import variance_split

__all__ = [
    "compare_all",
    "compare_rows",
    "difference_sentence",
    "group_letters",
    "intervals",
    "standings",
    "variance_split",
]
