"""Check the number of pairs required for a comparison by simulating tests."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from robustflow.core.errors import RunError, UsageError
from robustflow.data.datasets.kitti import drive_groups
from robustflow.data.datasets.split import kitti_split
from robustflow.report.comparison import power_table
from robustflow.report.render import render
from robustflow.stats.power import clusters_needed, detectable, plan_pairs, power_of

from ..refusals import refusal
from .simulated import compare_rows, rows_of

KEYS = kitti_split([f"{number:06d}" for number in range(200)]).evaluation
DRIVES = [drive_groups("kitti2015")[key] for key in KEYS]


def _simulated(effect: float, of_drive: float, of_pair: float, repeats: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Mean differences of two models and their standard errors, for pairs grouped by KITTI's drives."""
    rng = np.random.default_rng(3)
    sizes = np.unique(DRIVES, return_counts=True)[1]
    signs = np.where(np.arange(repeats) % 2, effect, -effect)[:, None]
    totals = sizes * (signs + of_drive * rng.normal(size=(repeats, len(sizes))))
    totals += of_pair * np.sqrt(sizes) * rng.normal(size=(repeats, len(sizes)))
    means = totals.sum(axis=1) / len(KEYS)
    influence = (totals - means[:, None] * sizes) / len(KEYS)
    return means, np.sqrt(len(sizes) / (len(sizes) - 1) * np.square(influence).sum(axis=1))


@pytest.mark.parametrize(("of_drive", "of_pair"), [(0.0, 1.0), (0.3, 0.6), (0.3, 0.3)])
@pytest.mark.parametrize("planned", [0.6, 0.8, 0.9])
def test_planned_power_is_that_of_simulated_tests_on_the_drives_of_kitti(of_drive, of_pair, planned):
    """Number of pairs planned from the mean standard error of a run on these drives."""
    from scipy.stats import t

    count = len(set(DRIVES))
    error = np.sqrt(np.mean(np.square(_simulated(0.0, of_drive, of_pair)[1])))
    effect = detectable(error * np.sqrt(count), count, planned)
    means, errors = _simulated(effect, of_drive, of_pair)
    found = np.mean(np.abs(means / errors) > t.ppf(0.975, count - 1))
    assert abs(found - planned) <= 0.03


@given(st.floats(0.01, 2), st.floats(0.01, 2), st.floats(0.5, 0.95))
def test_number_of_clusters_is_the_least_with_the_wanted_power(effect, deviation, wanted):
    number = clusters_needed(effect, deviation, wanted)
    assert power_of(effect, deviation, number) >= wanted
    assert number == 2 or power_of(effect, deviation, number - 1) < wanted
    assert detectable(deviation, number, wanted) <= effect * (1 + 1e-9)


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
    assert epe["clusters_needed"] == epe["pairs_needed"] == clusters_needed(0.1, differences.std(ddof=1))
    assert plan["measure"].to_list() == ["epe", "cre", "rcre"]
    table = render(power_table(plan, 0.8, 0.95), "csv")
    assert f"{epe['value']:+.3f},{epe['detectable']:.3f},40,40," in table
    assert "pairs for 0.1 px" in table
    assert f"({epe['clusters_low']:,} to {epe['clusters_high']:,})" in table


@pytest.mark.parametrize(("level", "fewest"), [(0.95, 4), (0.99, 5)])
def test_plan_needs_as_many_groups_as_a_comparison_tests(level, fewest):
    for count in (2, fewest - 1, fewest):
        rng = np.random.default_rng(count)
        clean, corrupted = rng.gamma(4, 1, count), rng.gamma(4, 1, (count, 3))
        runs = {"a": rows_of(clean, corrupted + 50, corrupted), "b": rows_of(clean, corrupted, corrupted)}
        tested = compare_rows(*runs.values(), ("a", "b"), level=level).filter(measure="epe", condition="average")
        assert (tested["p"][0] is None) == (count < fewest)
        noisy = {**runs, "b": rows_of(clean, corrupted + rng.normal(size=(count, 3)), corrupted)}
        if count < fewest:
            assert str(fewest) in str(refusal(partial(plan_pairs, noisy, 50, level=level), RunError, "a and b"))
        else:
            epe = plan_pairs(noisy, 50, level=level).filter(measure="epe").row(0, named=True)
            assert epe["clusters_needed"] == fewest


def test_interval_of_the_number_of_groups_covers_the_number_for_the_true_deviation():
    """Differences are normal with a deviation of 2 px, which needs 128 groups for an effect of 0.5 px."""
    rng, true = np.random.default_rng(1), clusters_needed(0.5, 2.0)
    hits = []
    for _ in range(120):
        errors = 10 + rng.normal(0, 2, (8, 1)) * np.ones(3)
        runs = {"a": rows_of(np.ones(8), errors, errors), "b": rows_of(np.ones(8), np.full((8, 3), 10.0), errors)}
        (plan,) = plan_pairs(runs, 0.5).filter(measure="epe").to_dicts()
        assert plan["clusters_low"] <= plan["clusters_needed"] <= plan["clusters_high"]
        scale = plan["standard_error"] * np.sqrt(8 * 7 / chi2.ppf([0.975, 0.025], 7))
        assert [plan["clusters_low"], plan["clusters_high"]] == [clusters_needed(0.5, one) for one in scale]
        hits.append(plan["clusters_low"] <= true <= plan["clusters_high"])
    assert 0.9 <= np.mean(hits) <= 0.99


ONE = {name: rows_of(np.ones(1), np.ones((1, 3)), np.ones((1, 3))) for name in "ab"}
REFUSED = [
    ((ONE, 0.1), {}, RunError, "a and b"),
    (({"a": ONE["a"]}, 0.1), {}, UsageError, ""),
    *(((ONE, effect), {}, UsageError, "effect") for effect in (0.0, float("nan"))),
    *(((ONE, 0.1), {"power": power}, UsageError, "power") for power in (1.0, 0.05)),
    ((ONE, 0.1), {"level": 0}, UsageError, "level"),
    ((ONE, 0.1), {"level": 0.1}, UsageError, "power"),
]


@pytest.mark.parametrize(("given", "options", "error", "culprit"), REFUSED)
def test_plan_without_a_variance_or_with_wrong_options_is_refused(given, options, error, culprit):
    refusal(lambda: plan_pairs(*given, **options), error, culprit)
