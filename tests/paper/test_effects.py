"""Differences between training methods: intervals have the claimed coverage, and only planned comparisons are made."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from robustflow.corruptions import FAMILIES, IMAGE_PAIR
from robustflow.paper.experiment.effects import (
    ALL,
    LEFT_OUT,
    PLAIN,
    TRAINED,
    arms,
    effects,
    interval,
    left_out,
    measured,
    members,
)
from robustflow.paper.experiment.findings import PRIMARY, findings


def test_each_arm_leaves_out_the_family_of_its_name():
    by_name = {arm.name: set(arm.corruptions) for arm in arms()}
    assert list(by_name) == [PLAIN, ALL, *(hypothesis.arm for hypothesis in PRIMARY)]
    assert by_name[PLAIN] == set()
    assert by_name[ALL] == set(IMAGE_PAIR) == {name for family in TRAINED for name in members(family)}
    for family in LEFT_OUT:
        assert by_name[f"no_{family}"] == set(IMAGE_PAIR) - set(FAMILIES[family])
        assert set(members(family)) <= set(measured())


@pytest.mark.parametrize("seeds", [3, 6])
@pytest.mark.parametrize("of_seeds", [0.0, 0.3])
def test_an_interval_covers_the_true_difference_as_often_as_it_says_on_skewed_pairs(seeds, of_seeds):
    rng = np.random.default_rng(0)
    trials, below, above, rejected = 300, 0, 0, 0
    for _ in range(trials):
        pairs = (rng.lognormal(0, 1, (1, 150)) - np.exp(0.5)) / np.sqrt(np.e * (np.e - 1))  # mean 0, variance 1
        noise = pairs + rng.normal(0, of_seeds, (seeds, 1)) + rng.normal(0, 1, (seeds, 150))
        result = interval(noise, resamples=300)
        assert result is not None
        below, above, rejected = below + (result.low > 0), above + (result.high < 0), rejected + (result.p < 0.05)
    # the standard error of a rate of 95 % in 300 trials is 1.3 %
    assert 0.93 < 1 - (below + above) / trials < 0.995
    assert rejected / trials < 0.07
    assert max(below, above) / trials < 0.055


def test_few_pairs_or_seeds_have_no_interval():
    rng = np.random.default_rng(1)
    assert interval(rng.normal(size=(6, 9))) is None
    assert interval(rng.normal(size=(2, 150))) is None
    assert interval(rng.normal(size=(3, 10))) is not None


def made_runs(seeds: int, changes: dict[str, float], clean: float = 1.0) -> dict[tuple[str, str, int], Any]:
    """Runs whose errors under noise and weather differ from those of plain training by the `changes` of each arm."""
    rng = np.random.default_rng(0)
    runs: dict[tuple[str, str, int], Any] = {}
    for seed in range(seeds):
        for arm in arms():
            rows = []
            for pair in range(40):
                for name in ("clean", *measured()):
                    added = 0.0 if name == "clean" else 2.0 + changes.get(arm.name, 0.0) + rng.normal(0, 0.05)
                    rows.append((f"{pair:06d}", name, 100 * (clean + added), 400.0, 100, 100 * added, 100))
            columns = ["sample", "corruption", "epe_sum", "magnitude_sum", "n_valid", "rcre_all_sum", "n_all"]
            clean_row = pl.col("corruption") == "clean"
            table = pl.DataFrame(rows, schema=columns, orient="row").with_columns(severity=3 * ~clean_row)
            runs[arm.name, "shapes", seed] = SimpleNamespace(rows=table, path="run")
    return runs


def test_findings_report_exactly_the_planted_changes():
    text, table = findings(made_runs(4, {"no_noise": -0.3}))
    lines = [line for line in text.splitlines() if line.startswith("- CRE")]
    assert "CRE under noise, which was left out of training: 2.00 to 1.70 px, difference -0.30 [-0.3" in lines[0]
    assert "it decreases" in lines[0]
    assert "the change is not significantly different from zero" in lines[1]
    one = table.row(
        by_predicate=(pl.col("arm") == "no_noise") & (pl.col("under") == "noise") & (pl.col("quantity") == "cre"),
        named=True,
    )
    assert one["difference"] == pytest.approx(-0.3, abs=0.01)
    assert not one["seen"]


def test_seed_with_a_missing_or_untrained_network_is_left_out():
    given = made_runs(5, {})
    given["all", "shapes", 1] = made_runs(1, {}, clean=2.1)["all", "shapes", 0]  # zero flow has an error of 4 px
    del given["no_weather", "shapes", 3]
    assert left_out(given, "shapes") == {
        1: "all: clean EPE 2.10 px, zero flow 4.00 px",
        3: "no_weather: not measured",
    }
    text, table = findings(given)
    assert "## Flying shapes: 40 pairs, 3 seeds" in text
    assert "Seed 3 is left out (no_weather: not measured)." in text
    assert table.equals(effects(given, "shapes", [0, 2, 4]))


def test_two_seeds_are_reported_without_a_test():
    text, table = findings(made_runs(2, {"no_noise": -0.3}))
    assert "With fewer than 3 seeds or 10 pairs there is no test" in text
    assert "it decreases" not in text
    assert table["p"].null_count() == len(table)
