"""Compare the paper's flat corruptions with their depth-dependent counterparts: differences for each model, and rank
correlations over models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl

from ..metrics.cube import Cube
from ..metrics.measures import MEASURES
from ..run.comparable import common_to, named_runs
from ..run.run import Run
from .bootstrap import Interval, bootstrap
from .estimate import Joint
from .exclusion import exclusions
from .ranking import rank_correlation
from .statistic import difference

TWINS = (
    ("fog", "fog_3d"),
    ("snow", "snow_3d"),
    ("defocus_blur", "near_focus"),
    ("defocus_blur", "far_focus"),
    ("camera_motion_blur", "motion_blur_3d"),
)
"""Pairs consisting of a corruption from the paper and its depth-dependent counterpart."""


@dataclass(frozen=True)
class TwinErrors:
    """One model under a flat corruption and its depth-dependent counterpart."""

    model: str
    flat: float
    deep: float
    difference: Interval
    excluded: str


@dataclass(frozen=True)
class TwinComparison:
    """A flat corruption and its depth-dependent counterpart, compared over several models."""

    flat: str
    deep: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[TwinErrors, ...]
    count: int
    rho: float | None
    interval: tuple[float, float] | None
    remark: str


def twin_comparisons(runs: Sequence[Run]) -> list[TwinComparison]:
    """Compare each pair of `TWINS` over the cells that all runs containing this pair have in common."""
    named = named_runs(runs)
    excluded = dict(zip(named, exclusions(runs), strict=True))
    found = []
    for twins in TWINS:
        having = {name: run for name, run in named.items() if set(twins) <= set(run.manifest.corruptions)}
        if not having:
            continue
        metric = "rcre" if any(run.cre is None for run in having.values()) else "cre"
        common = common_to(having)
        parts = (rows.filter(corruption=twin) for rows in common.rows.values() for twin in twins)
        shared = sorted(set.intersection(*(set(part["severity"]) for part in parts)))
        if not shared:
            continue
        models = []
        for name, rows in common.rows.items():
            joint = Joint([Cube.of(rows.filter(pl.col("severity").is_in([0, *shared])))])
            (flat,), (deep,) = (joint.forms(MEASURES[metric], twin) or [] for twin in twins)
            one = bootstrap({"flat": flat, "deep": deep, "difference": difference(deep, flat)}, joint.clusters)
            errors = one["flat"].estimate, one["deep"].estimate
            models.append(TwinErrors(name, *errors, one["difference"], excluded[name]))
        ranked = [(model.flat, model.deep) for model in models if not model.excluded]
        rho, ends = rank_correlation(*([error[at] for error in ranked] for at in (0, 1)))
        remark = common.remark
        found.append(TwinComparison(*twins, tuple(shared), metric, tuple(models), len(ranked), rho, ends, remark))
    return found
