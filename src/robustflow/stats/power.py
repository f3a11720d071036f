"""Power analysis: the number of pairs needed to compare two models, based on existing measurements.

With G clusters (drives or sequences, or single pairs if these are independent), the difference of two means has the
standard error s / sqrt(G). If the models differ by `effect`, the difference divided by its estimated standard error
follows, to first order, the noncentral t distribution with G - 1 degrees of freedom and noncentrality sqrt(G) effect /
s. The test detects the difference if this ratio exceeds the quantile of the t distribution. The required number of
pairs assumes additional clusters like those measured; more frames of the same drives add less information.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from ..core.text import counted
from ..metrics.cube import AVERAGE
from ..metrics.measures import Ratio
from ..run.comparable import common_rows
from .bootstrap import LEVEL, enough_clusters, fewest_clusters
from .estimate import HEADLINE, Joint, cubes_of
from .statistic import difference, of_data

POWER = 0.8
_MOST_CLUSTERS = 10**9

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


def power_of(effect: float, deviation: float, clusters: int, level: float = LEVEL) -> float:
    """Compute the probability that the paired test detects a difference, in either direction: 0 if there are too few
    clusters for a test.
    """
    from scipy.stats import nct, t

    if not enough_clusters(clusters, level):
        return 0.0
    if deviation == 0:
        return 1.0 if effect else 1 - level
    freedom = clusters - 1
    noncentrality = abs(effect) * math.sqrt(clusters) / deviation
    quantile = float(t.ppf((1 + level) / 2, freedom))
    if noncentrality > quantile + 10:
        return 1.0
    return float(nct.sf(quantile, freedom, noncentrality) + np.nan_to_num(nct.cdf(-quantile, freedom, noncentrality)))


def clusters_needed(effect: float, deviation: float, power: float = POWER, level: float = LEVEL) -> int | None:
    """Find the smallest number of clusters with which the test has the requested power; None if a billion are too
    few.
    """
    few, many = 1, 2
    while power_of(effect, deviation, many, level) < power:
        few, many = many, 2 * many
        if many > _MOST_CLUSTERS:
            return None
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if power_of(effect, deviation, middle, level) >= power else (middle, many)
    return many


def detectable(deviation: float, clusters: int, power: float = POWER, level: float = LEVEL) -> float | None:
    """Find the smallest difference, in pixels, that the test detects with the requested power; None if there are too
    few clusters for a test.
    """
    from scipy.optimize import brentq

    if not enough_clusters(clusters, level):
        return None
    if deviation == 0:
        return 0.0
    scale = deviation / math.sqrt(clusters)
    most = scale
    while power_of(most, deviation, clusters, level) < power:
        most *= 2
    return float(brentq(lambda effect: power_of(effect, deviation, clusters, level) - power, 0.0, most))


def plan_pairs(
    runs: Mapping[str, pl.DataFrame], effect: float, *, power: float = POWER, level: float = LEVEL
) -> pl.DataFrame:
    """Compute the number of pairs needed to detect a difference, for each pair of models and the averages of EPE, CRE
    and RCRE.
    """
    if not (math.isfinite(effect) and effect > 0):
        raise UsageError("effect", f"{effect:g} px cannot be detected: give a positive difference in pixels")
    for name, value in (("power", power), ("level", level)):
        if not 0 < value < 1:
            raise UsageError(name, f"{value:g} is out of range: give a probability between 0 and 1")
    if power <= 1 - level:
        raise UsageError(
            "power",
            f"{power:g} is out of range: a test at level {level:g} rejects equal models with probability "
            f"{1 - level:g}, so give a power above that",
        )
    if len(runs) < 2:
        raise UsageError("power analysis needs at least two models: give one run of each")
    from scipy.stats import chi2

    records = []
    for names in combinations(runs, 2):
        rows, _ = common_rows([runs[name] for name in names], list(names))
        joint = Joint([*cubes_of(dict(zip(names, rows, strict=True))).values()])
        count, images = joint.clusters, len(joint.cluster)
        if not enough_clusters(count, level):
            raise RunError(
                " and ".join(names),
                f"they share {counted(images, 'pair')} in {counted(count, 'group')} (drive, sequence or single "
                "pair), too few to estimate how much groups differ: run both on at least "
                f"{fewest_clusters(level)} groups",
            )
        for metric, measure in HEADLINE.items():
            forms = None if isinstance(measure, Ratio) else joint.forms(measure, AVERAGE)
            if forms is None:
                continue
            whole = of_data(difference(*forms), count)
            deviation = whole.error * math.sqrt(count)
            needed = clusters_needed(effect, deviation, power, level)
            pairs = None if needed is None else math.ceil(needed * images / count)
            ratios = chi2.ppf([(1 + level) / 2, (1 - level) / 2], count - 1) / (count - 1)  # of the variance of s
            ends = [clusters_needed(effect, deviation / ratio**0.5, power, level) for ratio in ratios.tolist()]
            known = (whole.value, whole.error, images, count, detectable(deviation, count, power, level))
            planned = (effect, power_of(effect, deviation, count, level), pairs, needed, *ends)
            records.append((*names, metric, *known, *planned))
    if not records:
        raise RunError("these runs have no average in common: run them on the same pairs under the same corruptions")
    return pl.DataFrame(records, schema=POWER_SCHEMA, orient="row")
