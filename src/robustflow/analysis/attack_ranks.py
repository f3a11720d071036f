"""Rank correlation between robustness to corruptions and robustness to attacks, over models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..runs.aggregate import summarize
from ..runs.comparable import common_to
from ..runs.run import Run
from .attacks import attack_scores
from .exclusion import exclusions
from .ranking import spearman, spearman_interval
from .run_names import run_names

LEAST_MODELS = 5
"""Minimum number of models for a rank correlation: with four models, one in twelve random orders has a correlation of 1
or -1."""


@dataclass(frozen=True)
class Prediction:
    """Rank correlation between robustness to one attack and robustness to corruptions, over several models.

    Attributes:
        attack: name of the attack.
        severities: severities at which all models were attacked.
        metric: "cre", or "rcre" without ground truth; used for both the corruptions and the attack.
        models: names of the compared models.
        left_out: model name -> reason for leaving the model out.
        rho: Spearman's rank correlation; None with fewer than `LEAST_MODELS` models or if one variable is constant.
        interval: 95 % confidence interval of `rho`.
    """

    attack: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[str, ...]
    left_out: dict[str, str]
    rho: float | None
    interval: tuple[float, float] | None


def predictions(runs: Sequence[Run]) -> list[Prediction]:
    """Compute the rank correlation for every attack that at least two runs have in common, in order of appearance.

    A model is left out for any attack that has a warning for it, and for all attacks if it should not be ranked. Errors
    under corruptions are computed over the cells that all runs have in common.

    Raises:
        RunError: the runs have no frames in common.
    """
    names = run_names(runs)
    named = {name: run for name, run in zip(names, runs, strict=True) if run.attacks}
    named = {name: run for name, run in named.items() if run.manifest.selection.corruptions}
    if len(named) < 2:
        return []
    unranked = {name: why for name, why in zip(names, exclusions(runs), strict=True) if why}
    scores = {name: attack_scores(run) for name, run in named.items()}
    metric = "rcre" if any(run.cre is None for run in named.values()) else "cre"
    before = _corrupted(named, metric)
    predicted = []
    for attack in dict.fromkeys(score.attack for of_run in scores.values() for score in of_run):
        of_attack = {
            name: {one.severity: one for one in of_run if one.attack == attack} for name, of_run in scores.items()
        }
        of_attack = {name: levels for name, levels in of_attack.items() if levels}
        shared = sorted(set.intersection(*(set(levels) for levels in of_attack.values())))
        if len(of_attack) < 2 or not shared:
            continue
        left_out = {name: unranked[name] for name in of_attack if name in unranked}
        for name, levels in of_attack.items():
            if any(levels[level].warnings for level in shared):
                left_out.setdefault(name, "its score has a warning")
        after = {
            name: math.fsum(getattr(levels[level], metric) for level in shared)
            for name, levels in of_attack.items()
            if name not in left_out
        }
        rho = None
        if len(after) >= LEAST_MODELS:
            rho = spearman([before[name] for name in after], list(after.values()))
        ends = None if rho is None else spearman_interval(rho, len(after))
        predicted.append(Prediction(attack, tuple(shared), metric, tuple(after), left_out, rho, ends))
    return predicted


def _corrupted(runs: Mapping[str, Run], metric: str) -> dict[str, float]:
    """Return the mean increase in error (or mean change in flow) under corruptions, in px, by model name."""
    rows = common_to(runs).rows
    return {name: getattr(summarize(part, paper=()), metric) for name, part in rows.items()}
