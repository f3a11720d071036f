"""Differences between ways of training: their intervals hold what they say."""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.corruptions import FAMILIES, IMAGE_PAIR
from robustflow.experiments.arms import ALL, PLAIN, TESTED, arms, members
from robustflow.experiments.effects import paired_effect


def test_every_arm_but_one_leaves_out_what_it_says():
    by_name = {arm.name: set(arm.corruptions) for arm in arms()}
    assert by_name[PLAIN] == set()
    assert by_name[ALL] == set(IMAGE_PAIR)
    for family in TESTED:
        assert by_name[f"no_{family}"] == set(IMAGE_PAIR) - set(FAMILIES[family])
    assert sorted(name for family in TESTED for name in members(family)) == sorted(IMAGE_PAIR)


@pytest.mark.parametrize(("of_seeds", "of_pairs"), [(0.0, 1.0), (0.3, 1.0), (1.0, 0.1), (0.05, 0.5)])
def test_an_interval_holds_the_true_difference_at_least_as_often_as_it_says(of_seeds, of_pairs):
    rng = np.random.default_rng(0)
    trials, held = 1500, 0
    for _ in range(trials):
        plain = rng.normal(3, 1, (3, 20))
        noise = rng.normal(0, of_seeds, (3, 1)) + rng.normal(0, of_pairs, (1, 20)) + rng.normal(0, 0.1, (3, 20))
        effect = paired_effect(plain, plain + 0.7 + noise)
        held += effect.low <= 0.7 <= effect.high
    assert held / trials > 0.94


def test_few_pairs_or_one_seed_have_no_interval():
    rng = np.random.default_rng(1)
    for shape in ((3, 4), (1, 50)):
        effect = paired_effect(rng.normal(size=shape), rng.normal(size=shape))
        assert effect.low is None
        assert effect.high is None
