"""Ranks as in the paper's Tab. 3, rank correlation, and the best number of each column.

Equal printed values share the smallest rank, and the following rank is skipped (1, 2, 2, 4). FLOPs are ranked over all
14 models regardless of setting, CREr over the models of one setting, both as printed. The average rank is the rank of
the mean of the two ranks, with ties handled in the same way. These rules reproduce every rank that the paper prints.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

Name = TypeVar("Name", bound=Hashable)

LEAST_MODELS = 5
"""Minimum number of models for a rank correlation or a trend: with four models, one in twelve random orders has a rank
correlation of 1 or -1."""

_NORMAL = 1.959964
"""Half-width of a 95 % interval, in standard errors."""


def competition_ranks(values: Mapping[Name, float]) -> dict[Name, int]:
    """Rank values, starting with 1 for the smallest; equal values share a rank and the following ranks are skipped."""
    ordered = sorted(values.values())
    if any(value != value for value in ordered):
        raise ValueError("NaN values cannot be ranked")
    return {name: bisect_left(ordered, value) + 1 for name, value in values.items()}


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values by Holm's step-down method (Holm 1979). Rejecting every hypothesis whose adjusted p-value is
    below a level keeps the probability of any false rejection below this level, regardless of the dependence
    between the tests.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def middle_ranks(values: Sequence[float]) -> list[float]:
    """Rank values, starting with 1 for the smallest; equal values share the mean of the ranks that they occupy."""
    ordered = sorted(values)
    if any(value != value for value in ordered):
        return [float("nan")] * len(ordered)
    return [(bisect_left(ordered, value) + bisect_right(ordered, value) + 1) / 2 for value in values]


def average_ranks(*rankings: Mapping[Name, int]) -> dict[Name, int]:
    """Rank names by their mean rank, considering only names that appear in all rankings."""
    names = [name for name in rankings[0] if all(name in ranking for ranking in rankings)]
    return competition_ranks({name: sum(ranking[name] for ranking in rankings) for name in names})


def spearman(first: Iterable[float], second: Iterable[float]) -> float | None:
    """Compute Spearman's rank correlation with mean ranks for ties; None if one variable is constant."""
    a, b = (np.array(middle_ranks(list(values))) for values in (first, second))
    a, b = a - a.mean(), b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale else None


def spearman_interval(rho: float, count: int) -> tuple[float, float]:
    """Compute the 95 % interval of a rank correlation of at least four pairs, by Fisher's z with the variance of Bonett
    and Wright (2000). Correlations of 1 and -1 are first moved towards 0 by half of the change that swapping two
    neighbouring ranks causes.
    """
    most = 1 - 6 / (count**3 - count)
    inside = min(max(rho, -most), most)
    reach = _NORMAL * math.sqrt((1 + inside * inside / 2) / (count - 3))
    low, high = (math.tanh(math.atanh(inside) + side * reach) for side in (-1, 1))
    return min(low, rho), max(high, rho)


def rank_correlation(
    first: Sequence[float], second: Sequence[float]
) -> tuple[float | None, tuple[float, float] | None]:
    """Compute Spearman's rank correlation over models and its 95 % interval; None with fewer than `LEAST_MODELS` models
    or if one variable is constant.

    >>> rank_correlation([1, 2, 3, 4], [1, 2, 3, 4])
    (None, None)
    """
    rho = spearman(first, second) if len(first) >= LEAST_MODELS else None
    return rho, None if rho is None else spearman_interval(rho, len(first))


def partial_spearman(first: Sequence[float], second: Sequence[float], given: Sequence[float]) -> float | None:
    """Compute the rank correlation of two variables given a third, whose ranks are regressed out of both; None if
    either residual is constant.

    >>> partial_spearman([1, 2, 3, 4], [1, 2, 4, 3], [1, 2, 3, 4]) is None
    True
    """
    pairs = ((first, second), (first, given), (second, given))
    both, one, other = (spearman(*pair) for pair in pairs)
    if both is None:
        return None
    if one is None or other is None:
        return both  # a constant variable explains nothing
    rest = (1 - one * one) * (1 - other * other)
    return (both - one * other) / math.sqrt(rest) if rest > 1e-12 else None


def best_of_columns(lines: Sequence[tuple[Hashable, Mapping[Name, str]] | None]) -> list[set[Name]]:
    """Return, for each line, the columns in which it has the smallest printed number of its group. As in the paper, all
    lines with the same smallest printed number are marked; a line that is alone in its group is not marked, and one
    that is excluded (None) does not count.

    >>> best_of_columns([("OOD", {"epe": "4.20"}), ("OOD", {"epe": "4.2"}), None, ("ID", {"epe": "1.00"})])
    [{'epe'}, {'epe'}, set(), set()]
    """
    groups: dict[Hashable, list[Mapping[Name, str]]] = {}
    for group, texts in filter(None, lines):
        groups.setdefault(group, []).append(texts)
    least = {
        (group, key): min(float(texts[key]) for texts in members if key in texts)
        for group, members in groups.items()
        if len(members) > 1
        for key in {key for texts in members for key in texts}
    }
    return [
        {key for key, text in line[1].items() if float(text) == least.get((line[0], key))} if line else set()
        for line in lines
    ]
