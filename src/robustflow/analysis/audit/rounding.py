"""How far apart rounding can put a printed number and one that follows from other printed numbers."""

from __future__ import annotations

from typing import NamedTuple

_UNROUNDED = 1e-9
_FLOAT = 1e-9
"""Tolerance for binary fractions: 0.1 + 0.2 is not a mismatch."""


class Printed(NamedTuple):
    """A number as it was printed, with its decimals; None for one that was not rounded."""

    value: float
    decimals: int | None

    @property
    def half(self) -> float:
        """Half a unit of the last digit: the exact value is at most that far off.

        >>> Printed(4.2, 2).half
        0.005
        """
        return _UNROUNDED * max(1.0, abs(self.value)) if self.decimals is None else 0.5 * 10.0**-self.decimals


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
