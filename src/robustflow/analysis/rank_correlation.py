"""Spearman's rank correlation, alone and with a third variable removed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from .ranking import middle_ranks


def spearman(first: Iterable[float], second: Iterable[float]) -> float | None:
    """Rank correlation, ties sharing their mean rank; None if one of the two does not vary.

    >>> spearman([1, 2, 3], [10, 30, 20])
    0.5
    """
    a, b = (np.array(middle_ranks(list(values))) for values in (first, second))
    a, b = a - a.mean(), b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale else None


def partial_spearman(first: Sequence[float], second: Sequence[float], given: Sequence[float]) -> float | None:
    """Rank correlation of two variables with the ranks of a third removed from both; None if nothing is left to
    correlate.

    >>> partial_spearman([1, 2, 3, 4], [1, 2, 4, 3], [1, 2, 3, 4]) is None
    True
    """
    pairs = ((first, second), (first, given), (second, given))
    both, one, other = (spearman(*pair) for pair in pairs)
    if both is None:
        return None
    if one is None or other is None:
        return both  # What does not vary explains nothing.
    rest = (1 - one * one) * (1 - other * other)
    return (both - one * other) / math.sqrt(rest) if rest > 1e-12 else None
