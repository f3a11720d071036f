"""Rank correlation between robustness to corruptions and robustness to attacks, over models."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import polars as pl

from ..attacks.result import EXPLAINED, LOWER_BOUND
from ..metrics.rows import CLEAN
from ..run.aggregate import summarize
from ..run.comparable import common_to
from ..run.run import Run
from .attacks import attack_scores
from .exclusion import exclusions
from .ranking import rank_correlation
from .run_results import named_runs


@dataclass(frozen=True)
class Prediction:
    """Rank correlation between robustness to one attack and robustness to corruptions, over several models."""

    attack: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[str, ...]
    left_out: dict[str, str]
    lower_bounds: tuple[str, ...]
    rho: float | None
    interval: tuple[float, float] | None
    remark: str


def predictions(runs: Sequence[Run]) -> list[Prediction]:
    """Compute the rank correlation for every attack that at least two runs have in common, in order of appearance."""
    every = named_runs(runs)
    named = {name: run for name, run in every.items() if run.attacks and run.manifest.corruptions}
    if len(named) < 2:
        return []
    unranked = {name: why for name, why in zip(every, exclusions(runs), strict=True) if why}
    warned = {
        name: {(score.attack, score.severity): set(score.warnings) for score in attack_scores(run)}
        for name, run in named.items()
    }
    metric = "rcre" if any(run.cre is None for run in named.values()) else "cre"
    common = common_to(named)
    before = common.rows
    samples = set.intersection(*(set(rows["sample"]) for rows in before.values()))
    increase = {name: getattr(summarize(rows, paper=()), metric) for name, rows in before.items()}
    predicted = []
    for attack in dict.fromkeys(attack for run in named.values() for attack in run.attacks):
        attacked = _common_rows(named, attack, samples)
        if len(attacked) < 2:
            continue
        shared = sorted(set(next(iter(attacked.values())).filter(corruption=attack)["severity"]))
        warnings = {
            name: {key for level in shared for key in warned[name].get((attack, level), ())} for name in attacked
        }
        left_out = {name: unranked[name] for name in attacked if name in unranked}
        for name, keys in warnings.items():
            if serious := sorted(keys - set(LOWER_BOUND)):
                left_out.setdefault(name, "; ".join(EXPLAINED.get(key, key) for key in serious))
        after = {
            name: math.fsum(filter(None, summarize(rows, paper=()).corruptions[attack].by_severity[metric]))
            for name, rows in attacked.items()
            if name not in left_out
        }
        rho, ends = rank_correlation([increase[name] for name in after], list(after.values()))
        lower = tuple(name for name in after if warnings[name])
        predicted.append(
            Prediction(attack, tuple(shared), metric, tuple(after), left_out, lower, rho, ends, common.remark)
        )
    return predicted


def _common_rows(runs: Mapping[str, Run], attack: str, samples: Collection[str]) -> dict[str, pl.DataFrame]:
    """Return, by model name, the clean rows and the attack's rows that all runs with this attack have in common."""
    rows = {
        name: run.attack_rows.filter(pl.col("corruption") == attack, pl.col("sample").is_in(list(samples)))
        for name, run in runs.items()
    }
    rows = {name: of_run for name, of_run in rows.items() if not of_run.is_empty()}
    for other in list(rows.values()):
        rows = {name: of_run.join(other, on=["sample", "severity"], how="semi") for name, of_run in rows.items()}
    return {
        name: pl.concat([runs[name].attack_rows.filter(corruption=CLEAN), of_run])
        for name, of_run in rows.items()
        if not of_run.is_empty()
    }
