"""Spearman's rank correlation, alone and with a third variable removed, and its one-sided p."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.special import stdtr

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


def p_of_growth(rho: float, count: int) -> float:
    """One-sided p of a rank correlation: how often `count` pairs that are not related reach `rho` (Student's t).

    SciPy's `spearmanr(..., alternative="greater")` gives the same; importing it takes a second.

    >>> round(p_of_growth(0.5, 12), 4)
    0.0489
    """
    if rho >= 1.0:
        return 0.0
    freedom = count - 2
    return float(stdtr(freedom, -rho * math.sqrt(freedom / ((1.0 + rho) * (1.0 - rho))) if rho > -1.0 else math.inf))


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
