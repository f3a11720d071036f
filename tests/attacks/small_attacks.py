"""All attacks with few steps, on a small pair and a smooth network."""

from __future__ import annotations

import numpy as np

import robustflow as rf
from robustflow.attacks.registry import SHIPPED

from .smooth_net import random_pair, smooth_model

FEW = {
    "pgd": {"steps": 4, "starts": 1},
    "bim": {"steps": 4},
    "cospgd": {"steps": 4, "starts": 1},
    "apgd": {"steps": 12, "starts": 1},
    "pcfa": {"steps": 2},
    "square": {"queries": 30},
    "transfer": {"on": smooth_model(), "attack": "pgd", "steps": 4, "starts": 1},
    "worst_of": {"parts": "fgsm+square", "queries": 30},
}
"""Options that make an attack fast."""

ON_SMALL_PAIRS = [name for name in SHIPPED if name not in ("random_patch", "patch", "universal")]
"""Attacks that need no training samples and work on very small frames."""


def attacked_pair(name: str, model=None, severity: int = 4, seed: int = 0, **options):
    pair = random_pair()
    truth = np.zeros((8, 10, 2), np.float32)
    options = {**FEW.get(name, {}), **options}
    return pair, rf.attack(*pair, model or smooth_model(), name, severity, flow=truth, seed=seed, **options)
