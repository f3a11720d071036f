"""How far apart rounding can put a printed number and one that follows from other printed numbers."""

from __future__ import annotations

_FLOAT = 1e-9
"""Tolerance for binary fractions: 0.1 + 0.2 is not a mismatch."""


def misfits(given: float, recomputed: float, tolerance: float) -> bool:
    """Whether rounding cannot explain the difference.

    >>> misfits(0.48, 0.495, 0.015), misfits(0.48, 0.50, 0.015)
    (False, True)
    """
    return abs(given - recomputed) > tolerance + _FLOAT * max(1.0, abs(given))


def ratio_range(top: tuple[float, float], bottom: tuple[float, float]) -> tuple[float, float]:
    """The smallest and the largest quotient of two numbers known as (value, half), the second being positive.

    >>> ratio_range((1.0, 0.5), (2.0, 0.0))
    (0.25, 0.75)
    """
    ends = [(top[0] + a * top[1]) / (bottom[0] + b * bottom[1]) for a in (-1, 1) for b in (-1, 1)]
    return min(ends), max(ends)
