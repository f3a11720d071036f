"""Effects of the arms: differences from training without corruptions, with intervals over seeds and pairs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import polars as pl

from ..analysis.exclusion import missed_motion
from ..errors import UsageError
from ..metrics.rows import CLEAN
from ..runs.run import Run
from .arms import LEFT_OUT, PLAIN, TRAINED, arms, measured, members
from .interval import Array, interval

Runs = Mapping[tuple[str, str, int], Run]


@dataclass(frozen=True)
class Effect:
    """A mean difference from the arm without corruptions, in pixels (for `crer`, as a fraction); negative values are
    improvements.
    """

    difference: float
    error: float | None
    freedom: float | None
    low: float | None
    high: float | None
    p: float | None
    plain: float
    value: float


def effects(runs: Runs, dataset: str, seeds: Sequence[int]) -> pl.DataFrame:
    """Return all effects on a dataset."""
    names = [arm.name for arm in arms()]
    scores = {name: [_scores(runs[name, dataset, seed]) for seed in seeds] for name in names}
    plain = scores[PLAIN]
    lines = []
    for name in (name for name in names if name != PLAIN):
        for under, quantities in plain[0].items():
            about = {"data": dataset, "arm": name, "under": under, "seen": _trained_on(name, under)}
            for quantity in quantities:
                before, after = (np.stack([one[under][quantity] for one in scores[which]]) for which in (PLAIN, name))
                effect = _effect(before, after)
                lines.append({**about, "quantity": quantity, **asdict(effect)})
            if under != CLEAN:
                ratios = [_relative(scores[which], under) for which in (PLAIN, name)]
                effect = Effect(ratios[1] - ratios[0], None, None, None, None, None, *ratios)
                lines.append({**about, "quantity": "crer", **asdict(effect)})
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


def _effect(plain: Array, arm: Array) -> Effect:
    error, freedom, low, high, p = interval(arm - plain) or (None, None, None, None, None)
    return Effect(float((arm - plain).mean()), error, freedom, low, high, p, float(plain.mean()), float(arm.mean()))


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
                f"{run.path} must contain all of {', '.join(names)}; measure all corruptions of the experiment"
            )
        epe = _values_by_pair(part, "epe", pairs)
        scores[under] = {"epe": epe, "cre": epe - clean, "rcre": _values_by_pair(part, "rcre", pairs)}
    return scores


def _values_by_pair(rows: pl.DataFrame, column: str, pairs: list[str]) -> Array:
    means = rows.group_by("sample").agg(pl.col(column).mean()).sort("sample")
    if list(means["sample"]) != pairs:
        raise UsageError(f"some pairs have no measured {column}; measure every pair in the runs of an experiment")
    return means[column].to_numpy()
