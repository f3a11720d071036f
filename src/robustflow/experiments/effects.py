"""The effect of an arm: differences to training without corruptions, with intervals over seeds and pairs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.special import stdtrit

from ..analysis.doubts import missed_motion
from ..errors import UsageError
from ..metrics.rows import CLEAN
from ..runs.run import Run
from .arms import ALL, PLAIN, TESTED, members

_FEWEST = 10
"""Independent pairs below which there is no interval."""
_LEVEL = 0.95

Array = npt.NDArray[np.float64]
Runs = Mapping[tuple[str, str, int], Run]


@dataclass(frozen=True)
class Effect:
    """A mean difference to the arm without corruptions, in pixels (of `crer`: as a fraction); below 0 is better.

    Attributes:
        difference: mean over seeds and pairs.
        low, high: ends of its 95 % interval; None with too few pairs or seeds.
        plain, value: means of both.
    """

    difference: float
    low: float | None
    high: float | None
    plain: float
    value: float


def paired_effect(plain: Array, arm: Array) -> Effect:
    """The mean of `arm` - `plain`, values of (seeds, pairs), with an interval for other pairs and other seeds.

    The variance is that over pairs (of the means over seeds) and that over seeds (of the means over pairs), added: what
    is left over of either counts twice, so the interval is rather too wide. Student's t with the degrees of freedom of
    Satterthwaite (1946).

    >>> effect = paired_effect(np.zeros((3, 20)), np.ones((3, 20)) + np.arange(20) / 100)
    >>> round(effect.difference, 3), effect.low < effect.difference < effect.high
    (1.095, True)
    """
    difference = arm - plain
    mean = float(difference.mean())
    seeds, pairs = difference.shape
    low = high = None
    if pairs >= _FEWEST and seeds >= 2:
        parts = [(difference.mean(axis=0).var(ddof=1) / pairs, pairs - 1)]
        parts.append((difference.mean(axis=1).var(ddof=1) / seeds, seeds - 1))
        variance = sum(part for part, _ in parts)
        freedom = variance**2 / sum(part**2 / degrees for part, degrees in parts) if variance > 0 else math.inf
        reach = float(stdtrit(min(freedom, 1e6), 0.5 + _LEVEL / 2)) * math.sqrt(variance)
        low, high = mean - reach, mean + reach
    return Effect(mean, low, high, float(plain.mean()), float(arm.mean()))


def effects(runs: Runs, dataset: str, seeds: int) -> pl.DataFrame:
    """Every effect on a data set.

    Args:
        runs: by (arm, data set, seed).
        dataset: one of them.
        seeds: how many.

    Returns:
        A row for each arm, what it is measured under (a family, a corruption, "clean"), whether the arm was trained
        with it (null for "clean"), and quantity, with the fields of `Effect`. CREr is a ratio of means over pairs and
        seeds, because a pair whose clean error is next to nothing would outweigh all others; it has no interval.
    """
    names = list(dict.fromkeys(arm for arm, of, _ in runs if of == dataset))
    scores = {name: [_scores(runs[name, dataset, seed]) for seed in range(seeds)] for name in names}
    plain = scores[PLAIN]
    lines = []
    for name in (name for name in names if name != PLAIN):
        for under, quantities in plain[0].items():
            about = {"data": dataset, "arm": name, "under": under, "seen": _seen(name, under)}
            for quantity in quantities:
                before, after = (np.stack([one[under][quantity] for one in scores[which]]) for which in (PLAIN, name))
                effect = paired_effect(before, after)
                lines.append({**about, "quantity": quantity, **asdict(effect)})
            if under != CLEAN:
                ratios = [_relative(scores[which], under) for which in (PLAIN, name)]
                effect = Effect(ratios[1] - ratios[0], None, None, *ratios)
                lines.append({**about, "quantity": "crer", **asdict(effect)})
    return pl.DataFrame(lines, schema_overrides={"low": pl.Float64, "high": pl.Float64, "seen": pl.Boolean})


def unguarded(runs: Runs, dataset: str) -> list[str]:
    """Why networks cannot be compared on a data set: those whose clean error is not below half of zero flow's there."""
    reasons = []
    for (arm, of, seed), run in runs.items():
        if of != dataset:
            continue
        if (missed := missed_motion(run.rows)) is not None:
            reasons.append(f"{arm}, seed {seed}: clean EPE {missed[0]:.2f}, zero flow's {missed[1]:.2f}")
    return reasons


def _relative(scores: list[dict[str, dict[str, Array]]], under: str) -> float:
    clean = float(np.mean([one[CLEAN]["epe_clean"] for one in scores]))
    return float(np.mean([one[under]["cre"] for one in scores])) / clean if clean > 0 else math.nan


def _seen(arm: str, under: str) -> bool | None:
    if under == CLEAN:
        return None
    family = under if under in TESTED else next(name for name in TESTED if under in members(name))
    return arm == ALL or arm != f"no_{family}"


def _scores(run: Run) -> dict[str, dict[str, Array]]:
    """Per pair: the errors under each family and corruption, means over severities and corruptions."""
    rows = run.rows.filter(pl.col("n_valid") > 0).with_columns(
        epe=pl.col("epe_sum") / pl.col("n_valid"), rcre=pl.col("rcre_all_sum") / pl.col("n_all")
    )
    pairs = sorted(set(rows["sample"]))
    clean = _by_pair(rows.filter(pl.col("corruption") == CLEAN), "epe", pairs)
    scores: dict[str, dict[str, Array]] = {CLEAN: {"epe_clean": clean}}
    for family in TESTED:
        for under, names in ((family, members(family)), *((name, [name]) for name in members(family))):
            part = rows.filter(pl.col("corruption").is_in(names))
            if set(part["corruption"]) != set(names):
                raise UsageError(f"{run.path}: without {', '.join(names)}; measure all corruptions")
            epe = _by_pair(part, "epe", pairs)
            scores[under] = {"epe": epe, "cre": epe - clean, "rcre": _by_pair(part, "rcre", pairs)}
    return scores


def _by_pair(rows: pl.DataFrame, column: str, pairs: list[str]) -> Array:
    means = rows.group_by("sample").agg(pl.col(column).mean()).sort("sample")
    if list(means["sample"]) != pairs:
        raise UsageError(f"pairs without a measured {column}: the runs of an experiment measure every pair")
    return means[column].to_numpy()
