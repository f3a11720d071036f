"""Security curves: the error of a model as a function of the attack's budget, with intervals."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from ..metrics.rows import CLEAN
from ..runs.run import Run
from .attacks import attack_scores
from .uncertainty import intervals


@dataclass(frozen=True)
class CurvePoint:
    """The error of a model at one budget of one attack."""

    attack: str
    norm: str
    budget: float
    metric: str
    error: float
    low: float | None
    high: float | None
    warned: bool


def security_curves(run: Run, seed: int = 0) -> list[CurvePoint]:
    """Compute each attack's curve over all budgets, starting with the clean frames; the attacks are in the order of the
    run.
    """
    scores = attack_scores(run)
    if not scores:
        return []
    metric = "rcre" if scores[0].epe is None else "epe"
    table = intervals(run.attack_rows, seed=seed, severities=True, metrics=[metric])
    ends = {
        (corruption, severity): (estimate, low, high)
        for corruption, severity, estimate, low, high in table.filter(
            pl.col("severity").is_not_null() | (pl.col("corruption") == CLEAN)
        )
        .select("corruption", "severity", "estimate", "low", "high")
        .iter_rows()
    }
    points = []
    for name, norm in dict.fromkeys((score.attack, score.norm) for score in scores):
        # The distance from the clean flow is 0 on the clean frames for any model.
        clean = ends.get((CLEAN, None), (0.0, None, None))
        points.append(CurvePoint(name, norm, 0.0, metric, *clean, warned=False))
        for score in sorted((one for one in scores if one.attack == name), key=lambda one: one.budget):
            if (name, score.severity) in ends:
                here = ends[name, score.severity]
                points.append(CurvePoint(name, norm, score.budget, metric, *here, warned=bool(score.warnings)))
    return points
