"""How certain a mean is: bootstrap intervals, paired tests, and what can be claimed about a difference.

`docs/design/uncertainty.md` explains the choice of methods and how well they work.
"""

from __future__ import annotations

from .intervals import intervals
from .paired import compare_all, compare_rows
from .sentences import difference_sentence
from .standings import rank_stability, standings
from .variance import variance_split

__all__ = [
    "compare_all",
    "compare_rows",
    "difference_sentence",
    "intervals",
    "rank_stability",
    "standings",
    "variance_split",
]
