"""Effective robustness: how much more robust a model is than its clean accuracy predicts.

Across many models, the corrupted error grows with the clean error (the paper's Observation 1). A model's residual from
this trend separates robustness from accuracy, as Taori et al. (2020) did for classification. The trend is a straight
line fitted to the logarithms of both errors of all other models, so that no model influences its own prediction. The
residual is reported as a factor: 0.8 means a corrupted error 20 % below the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..core.errors import UsageError
from .lines import LineKey, Lines
from .ranking import LEAST_MODELS
from .results import AVERAGE, CLEAN


class Effective(NamedTuple):
    """A model compared with the trend of the other models: errors in pixels, and the corrupted one as a share of the
    expected one."""

    clean: float
    corrupted: float
    expected: float
    factor: float


def effective_robustness(lines: Lines, *, by_setting: bool = True) -> dict[str, dict[LineKey, Effective]]:
    """Compare each model's corrupted EPE with the prediction from its clean EPE, by setting; the lowest factor is
    first."""
    groups: dict[str, dict[LineKey, tuple[float, float]]] = {}
    for key, numbers in lines.items():
        clean, corrupted = numbers.number("epe", CLEAN) or 0.0, numbers.number("epe", AVERAGE) or 0.0
        if clean > 0 and corrupted > 0:
            groups.setdefault(key.setting if by_setting else "", {})[key] = clean, corrupted
    of_setting = {
        setting: dict(sorted(_against_trend(group).items(), key=lambda item: item[1].factor))
        for setting, group in groups.items()
        if len(group) >= LEAST_MODELS and len({clean for clean, _ in group.values()}) > 2
    }
    if not of_setting:
        raise UsageError(
            f"effective robustness needs at least {LEAST_MODELS} models in one setting with clean and corrupted EPE"
        )
    return of_setting


def _against_trend(group: Mapping[LineKey, tuple[float, float]]) -> dict[LineKey, Effective]:
    clean, corrupted = np.log([*group.values()]).T
    out = {}
    for index, (key, errors) in enumerate(group.items()):
        others = np.arange(len(group)) != index
        trend = np.polyfit(clean[others], corrupted[others], 1)
        expected = math.exp(float(np.polyval(trend, clean[index])))
        out[key] = Effective(*errors, expected, errors[1] / expected)
    return out
