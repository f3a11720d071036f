"""Does robustness to corruptions predict robustness to attacks? Rank correlations over models."""

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
"""Models below which a rank correlation says nothing: of four, one order in twelve gives 1 or -1 by chance."""


@dataclass(frozen=True)
class Prediction:
    """One attack over several models.

    Attributes:
        attack: its name.
        severities: at which all of the models were attacked.
        metric: "cre", or "rcre" without ground truth, of both corruptions and attack.
        models: names of the compared models.
        left_out: model -> why it is not.
        rho: Spearman's rank correlation; None below `LEAST_MODELS`, or if one of the two does not vary.
        interval: 95 %, of `rho`.
    """

    attack: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[str, ...]
    left_out: dict[str, str]
    rho: float | None
    interval: tuple[float, float] | None


def predictions(runs: Sequence[Run]) -> list[Prediction]:
    """Every attack that two or more of the runs have, in the order of the first of them.

    A model is left out where its attack carries a warning, and everywhere if it should not be ranked. Errors under
    corruptions are over the cells that all of the runs have in common.

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
                left_out.setdefault(name, "its number carries a warning")
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
    """The mean increase of the error (the mean change of the flow) under corruptions, px, by name."""
    rows = common_to(runs).rows
    return {name: getattr(summarize(part, paper=()), metric) for name, part in rows.items()}
