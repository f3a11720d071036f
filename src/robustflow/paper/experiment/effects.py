"""The arms of the experiment, and their effects: differences from training without corruptions, with an interval and a
p-value by a bootstrap over pairs and seeds.

All arms have the same network, initial weights, data and number of updates; they differ in the corruptions of the
training frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.special import stdtr, stdtrit

from ...core.errors import UsageError
from ...corruptions import FAMILIES, IMAGE_PAIR
from ...metrics.rows import CLEAN
from ...run.run import Run
from ...stats.exclusion import missed_motion

TRAINED = ("digital", "illumination", "weather", "noise", "blur")
"""Corruption families for training frames; families for whole clips cannot be applied to a pair of images."""
LEFT_OUT = ("noise", "weather")
"""Families held out from training and used for evaluation: the two that increase the error the most."""
PLAIN, ALL = "plain", "all"


@dataclass(frozen=True)
class Arm:
    """One arm of the experiment."""

    name: str
    families: tuple[str, ...]

    @property
    def corruptions(self) -> list[str]:
        """Return the corruptions of the arm's families that can be applied to a pair of images."""
        return [name for family in self.families for name in members(family)]


def members(family: str) -> list[str]:
    """Return the corruptions of a family that can be applied to a pair of images."""
    return [name for name in FAMILIES[family] if name in IMAGE_PAIR]


def arms() -> list[Arm]:
    """Return the arms: one without corruptions, one with all families, and for each held-out family one with all
    families except that one.
    """
    without = [Arm(f"no_{left}", tuple(family for family in TRAINED if family != left)) for left in LEFT_OUT]
    return [Arm(PLAIN, ()), Arm(ALL, TRAINED), *without]


def measured() -> list[str]:
    """Return the corruptions under which every network is evaluated."""
    return [name for family in LEFT_OUT for name in members(family)]


Array = npt.NDArray[np.float64]

FEWEST_PAIRS, FEWEST_SEEDS = 10, 3
"""Minimum numbers of pairs and seeds for an interval and a p-value."""
_LEVEL = 0.95
_RESAMPLES = 4000


class MeanInterval(NamedTuple):
    """Standard error of a mean and its degrees of freedom, the 95 % interval, and the two-sided p-value for the
    hypothesis that the mean is 0."""

    error: float | None
    freedom: float | None
    low: float | None
    high: float | None
    p: float | None


_NO_INTERVAL = MeanInterval(None, None, None, None, None)


def interval(differences: Array, resamples: int = _RESAMPLES) -> MeanInterval | None:
    """Return the confidence interval of the mean over seeds and pairs."""
    seeds, pairs = differences.shape
    if seeds < FEWEST_SEEDS or pairs < FEWEST_PAIRS:
        return None
    mean, of_seeds, of_pairs = (
        float(part[0]) for part in _variances(differences, np.ones((1, seeds)), np.ones((1, pairs)))
    )
    error = math.sqrt(of_seeds + of_pairs)
    if error == 0:
        return MeanInterval(0.0, math.inf, mean, mean, float(mean == 0))
    freedom = error**4 / (of_seeds**2 / (seeds - 1) + of_pairs**2 / (pairs - 1))
    ratios = _bootstrapped(differences, mean, resamples)
    low, high = np.quantile(ratios, [(1 + _LEVEL) / 2, (1 - _LEVEL) / 2])
    reach = float(stdtrit(freedom, (1 + _LEVEL) / 2))
    beyond = min((ratios >= mean / error).sum(), (ratios <= mean / error).sum())
    p = max(2 * (beyond + 1) / (len(ratios) + 1), 2 * stdtr(freedom, -abs(mean / error)))
    ends = mean - max(float(low), reach) * error, mean - min(float(high), -reach) * error
    return MeanInterval(error, freedom, *ends, min(1.0, float(p)))


def _bootstrapped(differences: Array, mean: float, resamples: int) -> Array:
    """Return the errors of resampled means divided by their standard errors."""
    means, of_seeds, of_pairs = _variances(differences, *(_weights(count, resamples) for count in differences.shape))
    errors = np.sqrt(of_seeds + of_pairs)
    return (means - mean)[errors > 0] / errors[errors > 0]


@cache
def _weights(count: int, resamples: int) -> Array:
    """Return how often each of `count` items is drawn in each resample, (resamples, count)."""
    return np.random.default_rng(count).multinomial(count, np.full(count, 1 / count), resamples).astype(float)


def _variances(differences: Array, seed_weights: Array, pair_weights: Array) -> tuple[Array, Array, Array]:
    """Return weighted means and their variances over seeds and over pairs, for weights of shape (resamples, seeds) and
    (resamples, pairs)."""
    seeds, pairs = differences.shape
    by_seed = pair_weights @ differences.T / pairs
    by_pair = seed_weights @ differences / seeds
    means = (seed_weights * by_seed).sum(axis=1) / seeds
    over_seeds = (seed_weights * (by_seed - means[:, None]) ** 2).sum(axis=1) / (seeds - 1) / seeds
    over_pairs = (pair_weights * (by_pair - means[:, None]) ** 2).sum(axis=1) / (pairs - 1) / pairs
    return means, over_seeds, over_pairs


Runs = Mapping[tuple[str, str, int], Run]


def effects(runs: Runs, dataset: str, seeds: Sequence[int]) -> pl.DataFrame:
    """Return all effects on a dataset: mean differences from the arm without corruptions, in pixels (for `crer`, as a
    fraction); negative values are improvements."""
    names = [arm.name for arm in arms()]
    scores = {name: [_scores(runs[name, dataset, seed]) for seed in seeds] for name in names}
    plain = scores[PLAIN]
    lines = []
    for name in (name for name in names if name != PLAIN):
        for under, quantities in plain[0].items():
            about = {"data": dataset, "arm": name, "under": under, "seen": _trained_on(name, under)}
            for quantity in quantities:
                before, after = (np.stack([one[under][quantity] for one in scores[which]]) for which in (PLAIN, name))
                found = interval(after - before) or _NO_INTERVAL
                values = {"plain": float(before.mean()), "value": float(after.mean())}
                difference = {"difference": float((after - before).mean()), **found._asdict()}
                lines.append({**about, "quantity": quantity, **difference, **values})
            if under != CLEAN:
                ratios = {"plain": _relative(scores[PLAIN], under), "value": _relative(scores[name], under)}
                difference = {"difference": ratios["value"] - ratios["plain"], **_NO_INTERVAL._asdict()}
                lines.append({**about, "quantity": "crer", **difference, **ratios})
    return pl.DataFrame(
        lines,
        schema_overrides=dict.fromkeys(("error", "freedom", "low", "high", "p"), pl.Float64) | {"seen": pl.Boolean},
    )


def left_out(runs: Runs, dataset: str) -> dict[int, str]:
    """Return the seeds excluded from the comparison on a dataset, with the reason: a network is missing, or its clean
    error is not below half the error of zero flow."""
    reasons = {}
    for seed in sorted({seed for _, of, seed in runs if of == dataset}):
        for arm in arms():
            run = runs.get((arm.name, dataset, seed))
            reason = "not measured" if run is None else _missed_motion_text(run)
            if reason is not None:
                reasons[seed] = f"{arm.name}: {reason}"
                break
    return reasons


def _missed_motion_text(run: Run) -> str | None:
    missed = missed_motion(run.rows)
    return None if missed is None else f"clean EPE {missed[0]:.2f} px, zero flow {missed[1]:.2f} px"


def _relative(scores: list[dict[str, dict[str, Array]]], under: str) -> float:
    clean = float(np.mean([one[CLEAN]["epe_clean"] for one in scores]))
    return float(np.mean([one[under]["cre"] for one in scores])) / clean if clean > 0 else math.nan


def _trained_on(arm: str, under: str) -> bool | None:
    if under == CLEAN:
        return None
    family = under if under in TRAINED else next(name for name in TRAINED if under in members(name))
    return arm != f"no_{family}"


def _scores(run: Run) -> dict[str, dict[str, Array]]:
    """Return the errors of each pair under each family and corruption, as means over severities and corruptions."""
    rows = run.rows.filter(pl.col("n_valid") > 0).with_columns(
        epe=pl.col("epe_sum") / pl.col("n_valid"), rcre=pl.col("rcre_all_sum") / pl.col("n_all")
    )
    pairs = sorted(set(rows["sample"]))
    clean = _values_by_pair(rows.filter(pl.col("corruption") == CLEAN), "epe", pairs)
    scores: dict[str, dict[str, Array]] = {CLEAN: {"epe_clean": clean}}
    for under, names in {
        **{family: members(family) for family in LEFT_OUT},
        **{name: [name] for name in measured()},
    }.items():
        part = rows.filter(pl.col("corruption").is_in(names))
        if set(part["corruption"]) != set(names):
            raise UsageError(
                run.path, f"must contain all of {', '.join(names)}; measure all corruptions of the experiment"
            )
        epe = _values_by_pair(part, "epe", pairs)
        scores[under] = {"epe": epe, "cre": epe - clean, "rcre": _values_by_pair(part, "rcre", pairs)}
    return scores


def _values_by_pair(rows: pl.DataFrame, column: str, pairs: list[str]) -> Array:
    means = rows.group_by("sample").agg(pl.col(column).mean()).sort("sample")
    if list(means["sample"]) != pairs:
        raise UsageError(f"some pairs have no measured {column}; measure every pair in the runs of an experiment")
    return means[column].to_numpy()
