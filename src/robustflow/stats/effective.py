"""Effective robustness: how much more robust a model is than its clean accuracy predicts.

Across many models, the corrupted error grows with the clean error (the paper's Observation 1). A model's residual from
this trend separates robustness from accuracy, as Taori et al. (2020) did for classification. The trend is a straight
line fitted to the logarithms of both errors of all other models, so that no model influences its own prediction. The
residual is reported as a factor: 0.8 means a corrupted error 20 % below the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.errors import UsageError
from .model_result import ModelResult
from .ranking import LEAST_MODELS
from .results import AVERAGE, CLEAN


@dataclass(frozen=True)
class EffectiveRobustness:
    """A model compared with the trend of the other models."""

    line: ModelResult
    clean: float
    corrupted: float
    expected: float
    factor: float
    slope: float
    r_squared: float


def effective_robustness(
    results: Sequence[ModelResult], *, by_setting: bool = True
) -> dict[str, list[EffectiveRobustness]]:
    """Compare each model's corrupted EPE with the prediction from its clean EPE."""
    groups: dict[str, list[tuple[ModelResult, float, float]]] = {}
    for line in results:
        clean, corrupted = line.number("epe", CLEAN) or 0.0, line.number("epe", AVERAGE) or 0.0
        if clean > 0 and corrupted > 0:
            groups.setdefault(line.setting if by_setting else "", []).append((line, clean, corrupted))
    of_setting = {
        setting: sorted(_against_trend(group), key=lambda one: one.factor)
        for setting, group in groups.items()
        if len(group) >= LEAST_MODELS and len({clean for _, clean, _ in group}) > 2
    }
    if not of_setting:
        raise UsageError(
            f"effective robustness needs at least {LEAST_MODELS} models in one setting with clean and corrupted EPE"
        )
    return of_setting


def _against_trend(group: Sequence[tuple[ModelResult, float, float]]) -> list[EffectiveRobustness]:
    clean, corrupted = np.log([(clean, corrupted) for _, clean, corrupted in group]).T
    slope = float(np.polyfit(clean, corrupted, 1)[0])
    r_squared = float(np.corrcoef(clean, corrupted)[0, 1] ** 2)
    out = []
    for index, one in enumerate(group):
        others = np.arange(len(group)) != index
        trend = np.polyfit(clean[others], corrupted[others], 1)
        expected = math.exp(float(np.polyval(trend, clean[index])))
        out.append(EffectiveRobustness(*one, expected, one[2] / expected, slope, r_squared))
    return out
