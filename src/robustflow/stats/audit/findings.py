"""The findings of an audit: one record per inconsistent number, with the given and the recomputed value; printed
numbers are compared up to rounding.
"""

from __future__ import annotations

from ...core.types import Frozen, FrozenFinite

AUDIT_CHECKS = {
    "cre": "CRE is the corrupted minus the clean EPE",
    "crer": "CREr is CRE / clean EPE, with the CRE computed from the EPE",
    "crer_from_cre": "CREr is CRE / clean EPE, with the printed CRE",
    "average": "the average is the mean over corruptions",
    "bound": "RCRE is at least |EPE - clean EPE|",
    "best": "the best value in each column is marked",
    "rank": "ranks follow from the printed values",
    "rank_from_epe": "ranks follow from CREr computed from the EPE",
    "swapped": "each row belongs to its model",
    "shifted": "each value is in the right column",
}
"""Statement verified by each check."""


class Finding(FrozenFinite):
    """A number that differs from the value computed from other numbers by more than rounding can explain."""

    check: str
    source: str
    setting: str = ""
    model: str = ""
    metric: str = ""
    corruption: str = ""
    given: float | None = None
    recomputed: float | None = None
    tolerance: float | None = None
    message: str


class Audit(Frozen):
    """All findings, and the number of values that each check compared."""

    audited: str
    checked: dict[str, int]
    findings: list[Finding]

    @property
    def fits(self) -> bool:
        """Whether all numbers are consistent within rounding."""
        return not self.findings


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
