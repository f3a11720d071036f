"""Compare a printed number with one computed from other printed numbers, up to rounding."""

from __future__ import annotations

_FLOAT = 1e-9
"""Tolerance for floating-point error, so that 0.1 + 0.2 matches 0.3."""


def misfits(given: float, recomputed: float, tolerance: float) -> bool:
    """Whether the difference is too large to be explained by rounding.

    >>> misfits(0.48, 0.495, 0.015), misfits(0.48, 0.50, 0.015)
    (False, True)
    """
    return abs(given - recomputed) > tolerance + _FLOAT * max(1.0, abs(given))


def ratio_range(top: tuple[float, float], bottom: tuple[float, float]) -> tuple[float, float]:
    """Return the smallest and the largest quotient of two numbers, each given as (value, rounding error); the second
    must be positive.

    >>> ratio_range((1.0, 0.5), (2.0, 0.0))
    (0.25, 0.75)
    """
    ends = [(top[0] + a * top[1]) / (bottom[0] + b * bottom[1]) for a in (-1, 1) for b in (-1, 1)]
    return min(ends), max(ends)
