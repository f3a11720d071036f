"""Compare the paper's flat corruptions with their depth-dependent counterparts: differences for each model, and rank
correlations over models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from ..metrics.measures import MEASURES
from ..metrics.rows import CLEAN
from ..run.comparable import common_to, named_runs
from ..run.run import Run
from .estimate import contrast, cubes_of
from .exclusion import exclusions
from .ranking import rank_correlation

TWINS = (
    ("fog", "fog_3d"),
    ("snow", "snow_3d"),
    ("defocus_blur", "near_focus"),
    ("defocus_blur", "far_focus"),
    ("camera_motion_blur", "motion_blur_3d"),
)
"""Pairs consisting of a corruption from the paper and its depth-dependent counterpart."""


@dataclass(frozen=True)
class TwinComparison:
    """A flat corruption and its depth-dependent counterpart, compared over several models: a row of
    `estimate.CONTRASTS` for each, depth minus flat, with the reason why the model is `excluded` from the correlation.
    """

    flat: str
    deep: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[dict[str, Any], ...]
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
            of_twin = {twin: rows.filter(pl.col("severity").is_in([0, *shared])) for twin in reversed(twins)}
            alike = {
                twin: part.filter(pl.col("corruption").is_in([CLEAN, twin])).with_columns(
                    corruption=pl.col("corruption").replace(twin, twins[0])
                )
                for twin, part in of_twin.items()
            }
            (row,) = contrast(cubes_of(alike), {metric: MEASURES[metric]}, [(twins[0], None)]).to_dicts()
            models.append(row | {"model": name, "excluded": excluded[name]})
        ranked = [(row["value_against"], row["value_model"]) for row in models if not row["excluded"]]
        rho, ends = rank_correlation(*([errors[at] for errors in ranked] for at in (0, 1)))
        remark = common.remark
        found.append(TwinComparison(*twins, tuple(shared), metric, tuple(models), len(ranked), rho, ends, remark))
    return found
