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
import polars as pl
from scipy.stats import binomtest, ttest_1samp, ttest_ind

from ..core.text import counted
from ..stats.bootstrap import LEVEL
from ..stats.paired import standings
from ..stats.ranking import holm, rank_correlation

Verdict = Literal["holds", "does not hold", "too little evidence"]
THIN: Verdict = "too little evidence"


@dataclass(frozen=True)
class Margin:
    """A number that is positive if its claim holds."""

    estimate: float
    low: float
    high: float
    over: str

    @property
    def verdict(self) -> Verdict:
        """The verdict: whether the interval lies above 0, below 0, or contains 0."""
        return "holds" if self.low > 0 else "does not hold" if self.high < 0 else THIN

    def __str__(self) -> str:
        """
        >>> str(Margin(1.45, 0.921, 1.983, "9 families"))
        '+1.45 [+0.92, +1.98] over 9 families'
        """
        return f"{self.estimate:+.2f} [{self.low:+.2f}, {self.high:+.2f}] over {self.over}"


def joint(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the joint verdict on several claims."""
    found = set(verdicts)
    return "does not hold" if "does not hold" in found else THIN if THIN in found else "holds"


def of_mean(values: Sequence[float], over: str) -> Margin:
    """Compute the mean of values, one per unit named by `over` ("family", "corruption"), with Student's interval."""
    return _of_test(float(np.mean(values)), ttest_1samp(values, 0), _units(len(values), over))


def of_difference(larger: Sequence[float], smaller: Sequence[float]) -> Margin:
    """Compute the difference of two means over families with Welch's interval."""
    words = f"{len(larger)} and {_units(len(smaller), 'family')}"
    return _of_test(float(np.mean(larger) - np.mean(smaller)), ttest_ind(larger, smaller, equal_var=False), words)


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
    return Margin(some / count - 0.5, float(ends.low) - 0.5, float(ends.high) - 0.5, _units(count, over))


def places(values: Mapping[str, Sequence[float]]) -> dict[str, tuple[int, int]]:
    """Compute the best and the worst possible rank of each model (lower values rank first) by paired t-tests over the
    corruptions, corrected for all pairs.
    """
    pairs = list(combinations(values, 2))
    gaps = [np.subtract(values[first], values[second]) for first, second in pairs]
    records = [
        (*pair, "epe", float(np.mean(values[pair[0]])), float(np.mean(values[pair[1]])), float(gap.mean()), p, LEVEL)
        for pair, gap, p in zip(pairs, gaps, holm([_p(gap) for gap in gaps]), strict=True)
    ]
    columns = ("model", "against", "measure", "value_model", "value_against", "value", "p_adjusted", "level")
    table = standings(pl.DataFrame(records, schema=columns, orient="row"), list(values))
    ranks = {row["model"]: (row["best"], row["worst"]) for row in table.iter_rows(named=True)}
    return {name: ranks[name] for name in values}


def among(best: int, ranks: Sequence[tuple[int, int]]) -> Verdict:
    """Return the verdict on whether all models have a rank of at most `best`, given their possible ranks."""
    if any(first > best for first, _ in ranks):
        return "does not hold"
    return "holds" if all(last <= best for _, last in ranks) else THIN


def _p(gap: np.ndarray) -> float:
    return float(ttest_1samp(gap, 0).pvalue) if gap.any() else 1.0


def _units(count: int, over: str) -> str:
    return counted(count, over, {"family": "families"}.get(over))
