"""Check the number of pairs required for a comparison by simulating tests."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import RunError, UsageError
from robustflow.report.comparison import power_table
from robustflow.report.render import render
from robustflow.stats.inference import FEWEST, flip_test
from robustflow.stats.power import Differences, plan_pairs

from ..refusals import refusal
from .simulated import compare_rows, rows_of


@pytest.mark.parametrize(("clusters", "effect"), [(8, 1.2), (20, 0.7), (60, 0.4)])
def test_power_is_the_share_of_simulated_comparisons_that_are_significant(clusters, effect):
    """Skewed differences, drawn from the same population as the measured ones."""
    population = np.random.default_rng(0).lognormal(0, 0.8, 4000)
    found = Differences(population)
    rng = np.random.default_rng(1)
    drawn = rng.choice(population - population.mean() + effect, (2000, clusters))
    assert found.power(effect, clusters) == pytest.approx(np.mean(flip_test(drawn) <= 0.05), abs=0.05)


def test_power_beyond_the_simulated_numbers_continues_it():
    found = Differences(np.random.default_rng(2).normal(0, 1, 50))
    for effect in (0.1, 0.2):
        assert found.power(effect, 200) == pytest.approx(found.power(effect, 201), abs=0.05)


@settings(max_examples=15)
@given(st.floats(0.3, 2), st.floats(0.5, 0.95))
def test_number_of_clusters_is_the_least_with_the_wanted_power(effect, wanted):
    found = Differences(np.random.default_rng(3).normal(0, 1, 40))
    number = found.clusters_needed(effect, wanted)
    assert found.power(effect, number) >= wanted
    assert number == FEWEST or found.power(effect, number - 1) < wanted
    assert found.detectable(number, wanted) <= effect * 1.01


def test_plan_has_the_standard_error_of_the_difference_of_the_pairs():
    rng = np.random.default_rng(0)
    clean, corrupted, moved = rng.gamma(4, 1, 40), rng.gamma(4, 1, (40, 3)), rng.gamma(4, 1, (40, 3))
    other = corrupted + rng.normal(0.2, 0.5, (40, 3))
    plan = plan_pairs({"a": rows_of(clean, other, moved), "b": rows_of(clean, corrupted, moved)}, 0.1)
    epe = plan.filter(measure="epe").row(0, named=True)
    weights = np.array([0.25, 0.25, 0.5])  # fog at two severities, then snow
    differences = (other - corrupted) @ weights
    assert epe["value"] == pytest.approx(differences.mean())
    assert epe["standard_error"] == pytest.approx(differences.std(ddof=1) / np.sqrt(40))
    assert epe["clusters_needed"] == epe["pairs_needed"] == Differences(differences).clusters_needed(0.1)
    assert plan["measure"].to_list() == ["epe", "cre", "rcre"]
    table = render(power_table(plan, 0.8), "csv")
    assert f"{epe['value']:+.3f},{epe['detectable']:.3f},40,40," in table
    assert "pairs for 0.1 px" in table
    assert f"({epe['clusters_low']:,} to {epe['clusters_high']:,})" in table


def test_plan_needs_as_many_groups_as_a_comparison_tests():
    for count in (2, FEWEST - 1, FEWEST):
        rng = np.random.default_rng(count)
        clean, corrupted = rng.gamma(4, 1, count), rng.gamma(4, 1, (count, 3))
        runs = {"a": rows_of(clean, corrupted + 50, corrupted), "b": rows_of(clean, corrupted, corrupted)}
        tested = compare_rows(*runs.values(), ("a", "b")).filter(measure="epe", condition="average")
        assert (tested["p"][0] is None) == (count < FEWEST)
        noisy = {**runs, "b": rows_of(clean, corrupted + rng.normal(size=(count, 3)), corrupted)}
        if count < FEWEST:
            assert str(FEWEST) in str(refusal(partial(plan_pairs, noisy, 50), RunError, "a and b"))
        else:
            epe = plan_pairs(noisy, 50).filter(measure="epe").row(0, named=True)
            assert epe["clusters_needed"] == FEWEST


ONE = {name: rows_of(np.ones(1), np.ones((1, 3)), np.ones((1, 3))) for name in "ab"}
REFUSED = [
    ((ONE, 0.1), {}, RunError, "a and b"),
    (({"a": ONE["a"]}, 0.1), {}, UsageError, ""),
    *(((ONE, effect), {}, UsageError, "effect") for effect in (0.0, float("nan"))),
    *(((ONE, 0.1), {"power": power}, UsageError, "power") for power in (1.0, 0.05)),
]


@pytest.mark.parametrize(("given", "options", "error", "culprit"), REFUSED)
def test_plan_without_a_variance_or_with_wrong_options_is_refused(given, options, error, culprit):
    refusal(lambda: plan_pairs(*given, **options), error, culprit)
