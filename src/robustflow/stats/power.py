"""Power analysis: the number of pairs needed to compare two models, based on existing measurements.

The sign-flip test that compares models (`inference`) is simulated: clusters (drives or sequences, or single pairs if
these are independent) are drawn with replacement from those measured, with their differences shifted to the effect.
Above `_SIMULATED` clusters, the mean is normal, and so the power follows from its standard error. The required number
of pairs assumes additional clusters like those measured; more frames of the same drives add less information.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, partial
from itertools import combinations
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from ..core.rng import Rng
from ..core.text import counted
from ..metrics.cube import AVERAGE
from ..metrics.measures import Ratio
from ..run.comparable import common_rows
from .estimate import HEADLINE, Joint, cubes_of
from .inference import FEWEST, Array, flip_test

POWER = 0.8
_SIMULATED, _SAMPLES, _FLIPS = 200, 1000, 999
_MOST_CLUSTERS = 10**9
_NORMAL = 1.959964

POWER_SCHEMA: dict[str, Any] = {
    "model": pl.String,
    "against": pl.String,
    "measure": pl.String,
    "value": pl.Float64,
    "standard_error": pl.Float64,
    "pairs": pl.Int64,
    "clusters": pl.Int64,
    "detectable": pl.Float64,
    "effect": pl.Float64,
    "power": pl.Float64,
    "pairs_needed": pl.Int64,
    "clusters_needed": pl.Int64,
    "clusters_low": pl.Int64,
    "clusters_high": pl.Int64,
}
"""`detectable` is the difference in pixels that these clusters detect with the requested power, `power` the power to
detect `effect` with these clusters, and `pairs_needed` and `clusters_needed` the numbers of images and clusters needed
to detect `effect` with the requested power. `clusters_low` and `clusters_high` are the ends of an interval for the
latter, which follows from the chi-squared distribution of a variance (null: over a billion)."""


class Differences:
    """The differences of two models in clusters, float64 (G,), as a population to draw clusters from."""

    def __init__(self, values: Array) -> None:
        self.centered = values - values.mean()
        self._drawn: dict[int, Array] = {}

    @cached_property
    def deviation(self) -> float:
        """The standard deviation over clusters."""
        return float(self.centered.std(ddof=1))

    def power(self, effect: float, clusters: int) -> float:
        """Return the probability that the test at 5 % detects a difference of means in a number of clusters."""
        if clusters < FEWEST:
            return 0.0
        if self.deviation == 0:
            return float(effect != 0)
        if clusters > _SIMULATED:
            return float(_normal_tail(_NORMAL - abs(effect) * math.sqrt(clusters) / self.deviation))
        return float(np.mean(flip_test(self._samples(clusters) + effect, _FLIPS) <= 0.05))

    def _samples(self, clusters: int) -> Array:
        if clusters not in self._drawn:
            drawn = Rng.of(0, "power", clusters).uniforms(_SAMPLES * clusters) * len(self.centered)
            self._drawn[clusters] = self.centered[drawn.astype(np.int64)].reshape(_SAMPLES, clusters)
        return self._drawn[clusters]

    def clusters_needed(self, effect: float, power: float = POWER) -> int | None:
        """Find the smallest number of clusters with the requested power; None if a billion are too few."""
        few, many = FEWEST - 1, FEWEST
        while self.power(effect, many) < power:
            few, many = many, 2 * many
            if many > _MOST_CLUSTERS:
                return None
        while many - few > 1:
            middle = (few + many) // 2
            few, many = (few, middle) if self.power(effect, middle) >= power else (middle, many)
        return many

    def detectable(self, clusters: int, power: float = POWER) -> float | None:
        """Find the smallest difference, to within a percent, that is detected with the requested power; None if there
        are too few clusters for a test."""
        if clusters < FEWEST:
            return None
        if self.deviation == 0:
            return 0.0
        least, most = 0.0, self.deviation / math.sqrt(clusters)
        while self.power(most, clusters) < power:
            least, most = most, 2 * most
        while most - least > 0.01 * most:
            middle = (least + most) / 2
            least, most = (least, middle) if self.power(middle, clusters) >= power else (middle, most)
        return most


def _normal_tail(quantile: float) -> float:
    return 0.5 * math.erfc(quantile / math.sqrt(2))


def plan_pairs(runs: Mapping[str, pl.DataFrame], effect: float, *, power: float = POWER) -> pl.DataFrame:
    """Compute the number of pairs needed to detect a difference, for each pair of models and the averages of EPE, CRE
    and RCRE.
    """
    if not (math.isfinite(effect) and effect > 0):
        raise UsageError("effect", f"{effect:g} px cannot be detected: give a positive difference in pixels")
    if not 0.05 < power < 1:
        raise UsageError("power", f"{power:g} is out of range: give a probability above 0.05, the level, and below 1")
    if len(runs) < 2:
        raise UsageError("power analysis needs at least two models: give one run of each")
    records = []
    for names in combinations(runs, 2):
        rows = common_rows([runs[name] for name in names], list(names))[0]
        joint = Joint(list(cubes_of(dict(zip(names, rows, strict=True))).values()))
        pairs, count = len(joint.cubes[0].samples), joint.clusters
        if count < FEWEST:
            raise RunError(
                " and ".join(names),
                f"they share {counted(pairs, 'pair')} in {counted(count, 'group')} (drive, sequence or single pair), "
                f"too few to estimate how much groups differ: run both on at least {FEWEST} groups",
            )
        for name, measure in HEADLINE.items():
            scores = None if isinstance(measure, Ratio) else joint.scores(measure, AVERAGE)
            if scores is None:
                continue
            one, other = scores
            there = one.den > 0
            found = Differences((one.num - other.num)[there] / one.den[there])
            known = (float((one - other).mean), float((one - other).error), pairs, count)
            record = dict(zip(POWER_SCHEMA, (*names, name, *known), strict=False))
            records.append(record | _plan(found, effect, power, count, pairs / count))
    if not records:
        raise RunError("these runs have no average in common: run them on the same pairs under the same corruptions")
    return pl.DataFrame(records, schema=POWER_SCHEMA)


def _plan(found: Differences, effect: float, power: float, clusters: int, pairs_of_cluster: float) -> dict[str, Any]:
    from scipy.stats import chi2

    needed = partial(found.clusters_needed, power=power)
    count = needed(effect)
    ratios = chi2.ppf([0.975, 0.025], clusters - 1) / (clusters - 1)  # of the variance
    low, high = (needed(effect * ratio**0.5) for ratio in ratios.tolist())
    return {
        "detectable": found.detectable(clusters, power),
        "effect": effect,
        "power": found.power(effect, clusters),
        "pairs_needed": None if count is None else math.ceil(count * pairs_of_cluster),
        "clusters_needed": count,
        "clusters_low": low,
        "clusters_high": high,
    }
