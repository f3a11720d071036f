"""Margins of claims, with confidence intervals over model families or corruptions.

Published results are means without values per image, so conclusions can be generalised to other models or corruptions,
but not to other images.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.stats import binomtest, ttest_1samp, ttest_ind

from ..core.text import counted
from ..stats.inference import LEVEL
from ..stats.ranking import holm, rank_correlation

Verdict = Literal["yes", "no", "too little evidence"]


@dataclass(frozen=True)
class Margin:
    """A number that is positive if its claim holds, and its interval."""

    estimate: float
    low: float
    high: float
    over: str

    @property
    def verdict(self) -> Verdict:
        """Whether the interval lies above 0, below 0, or contains 0."""
        return "yes" if self.low > 0 else "no" if self.high < 0 else "too little evidence"

    def __str__(self) -> str:
        """
        >>> str(Margin(1.45, 0.921, 1.983, "over 9 families"))
        '+1.45 [+0.92, +1.98] over 9 families'
        """
        return f"{self.estimate:+.2f} [{self.low:+.2f}, {self.high:+.2f}] {self.over}"


def joint(margins: Iterable[Margin]) -> Margin:
    """Return the margin that decides whether several claims all hold: one that does not, else the lowest one."""
    return min(margins, key=lambda margin: (margin.high >= 0, margin.low))


def of_mean(values: Sequence[float], over: str) -> Margin:
    """Compute the mean of values, one per unit named by `over` ("family", "corruption"), with Student's interval."""
    return _of_test(float(np.mean(values)), ttest_1samp(values, 0), _units(len(values), over))


def of_difference(larger: Sequence[float], smaller: Sequence[float]) -> Margin:
    """Compute the difference of two means over families with Welch's interval."""
    over = f"over {len(larger)} and {counted(len(smaller), 'family', 'families')}"
    return _of_test(float(np.mean(larger) - np.mean(smaller)), ttest_ind(larger, smaller, equal_var=False), over)


def _of_test(estimate: float, test: Any, over: str) -> Margin:
    ends = test.confidence_interval(LEVEL)
    return Margin(estimate, float(ends.low), float(ends.high), over)


def of_correlation(first: Sequence[float], second: Sequence[float]) -> Margin:
    """Compute a `rank_correlation` over families."""
    rho, interval = rank_correlation(first, second)
    assert rho is not None
    assert interval is not None
    return Margin(rho, *interval, _units(len(first), "family"))


def of_majority(some: int, count: int, over: str) -> Margin:
    """Compute a share minus one half, with the exact interval of Clopper and Pearson (1934)."""
    ends = binomtest(some, count).proportion_ci(LEVEL)
    over = f"{_units(count, over)} (share minus 1/2)"
    return Margin(some / count - 0.5, float(ends.low) - 0.5, float(ends.high) - 0.5, over)


def of_ranks(values: Mapping[str, Sequence[float]], names: Sequence[str], best: int) -> Margin:
    """Compute by how many ranks the named models are within the `best` lowest means over corruptions, counted from
    best + 1/2 to the last of them. The interval is that of the possible ranks, by paired t-tests over the corruptions
    that are corrected for all pairs of models."""
    pairs = list(combinations(values, 2))
    gaps = [np.subtract(values[first], values[second]) for first, second in pairs]
    ranks = {name: [1, 1, len(values)] for name in values}  # by the means, best, worst
    for (first, second), gap, p in zip(pairs, gaps, holm([_p(gap) for gap in gaps]), strict=True):
        lower, higher = (first, second) if gap.mean() < 0 else (second, first)
        ranks[higher][0] += bool(gap.mean())
        ranks[higher][1] += p < 1 - LEVEL
        ranks[lower][2] -= p < 1 - LEVEL
    rank, least, most = (max(ends) for ends in zip(*(ranks[name] for name in names), strict=True))
    possible = ", ".join(f"{name} {ranks[name][1]} to {ranks[name][2]}" for name in names)
    count = counted(len(next(iter(values.values()))), "corruption")
    over = f"ranks over {count}; possible ranks: {possible}"
    return Margin(best + 0.5 - rank, best + 0.5 - most, best + 0.5 - least, over)


def _p(gap: np.ndarray) -> float:
    return float(ttest_1samp(gap, 0).pvalue) if gap.any() else 1.0


def _units(count: int, over: str) -> str:
    return f"over {counted(count, over, {'family': 'families'}.get(over))}"
