"""Effective robustness: how much better a model withstands corruptions than its clean accuracy predicts.

Over many models the corrupted error follows the clean error (the paper's Observation 1); the residual of a model from
that trend separates "robust" from "accurate" (Taori et al. 2020 did so for classification). The trend is a straight
line through the logarithms of both errors, fitted without the model itself, so that no model pulls the line towards
itself; the residual is given as a factor: 0.8 means a corrupted error 20 % below what the others' trend gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from ..errors import UsageError
from .model_result import ModelResult
from .results import AVERAGE, CLEAN

LEAST_MODELS = 5

EFFECTIVE_SCHEMA: dict[str, Any] = {
    "setting": pl.String,
    "model": pl.String,
    "epe_clean": pl.Float64,
    "epe": pl.Float64,
    "expected": pl.Float64,
    "factor": pl.Float64,
    "slope": pl.Float64,
    "r_squared": pl.Float64,
}


def effective_robustness(
    results: Sequence[ModelResult], *, corruption: str = AVERAGE, by_setting: bool = True, without: tuple[str, ...] = ()
) -> pl.DataFrame:
    """Corrupted EPE against what the clean EPE of the other models predicts.

    Args:
        results: of one benchmark and measured on the same frames.
        corruption: a corruption, or "average".
        by_setting: one trend per setting (domain knowledge shifts the trend, so one line over all settings would
            mistake it for robustness), or one over all.
        without: models that are left out of every trend and of the result.

    Returns:
        Columns of `EFFECTIVE_SCHEMA`, the most robust first within each setting: `expected` is the corrupted EPE by the
        trend of the others, `factor` the measured one divided by it, `slope` and `r_squared` those of the trend through
        all models (in logarithms). Settings with fewer than 5 models are left out.

    Raises:
        UsageError: no setting has 5 models with a clean and a corrupted EPE.

    >>> from robustflow.analysis.published.tables import published_results
    >>> of_kitti = [line for line in published_results() if line.benchmark == "kitti-fc"]
    >>> effective_robustness(of_kitti).filter(setting="ID").row(0, named=True)["model"]
    'ARFlow'
    """
    entries = [
        (line.setting, line.name, clean, value)
        for line in results
        if line.name not in without
        and (clean := line.number("epe", CLEAN) or 0.0) > 0
        and (value := line.number("epe", corruption) or 0.0) > 0
    ]
    groups: dict[str, list[tuple[str, str, float, float]]] = {}
    for entry in entries:
        groups.setdefault(entry[0] if by_setting else "", []).append(entry)
    records = []
    for group in groups.values():
        if len(group) >= LEAST_MODELS and len({clean for _, _, clean, _ in group}) > 2:
            records += sorted(_group(group), key=lambda record: record[5])
    if not records:
        raise UsageError(
            f"effective robustness needs {LEAST_MODELS} models of a setting with a clean and corrupted EPE"
        )
    return pl.DataFrame(records, schema=EFFECTIVE_SCHEMA, orient="row")


def _group(entries: list[tuple[str, str, float, float]]) -> list[tuple[Any, ...]]:
    clean, corrupted = (np.log([entry[index] for entry in entries]) for index in (2, 3))
    slope = np.polyfit(clean, corrupted, 1)[0]
    r_squared = float(np.corrcoef(clean, corrupted)[0, 1] ** 2)
    records = []
    for index, entry in enumerate(entries):
        others = np.arange(len(entries)) != index
        line = np.polyfit(clean[others], corrupted[others], 1)
        expected = math.exp(float(np.polyval(line, clean[index])))
        records.append((*entry, expected, entry[3] / expected, float(slope), r_squared))
    return records
