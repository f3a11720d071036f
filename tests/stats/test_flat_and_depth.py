"""Flat corruptions are compared with their 3D counterparts for models with known errors."""

import numpy as np
import polars as pl
import pytest

from robustflow.core.errors import UsageError
from robustflow.corruptions.registry import CORRUPTIONS, FURTHER
from robustflow.report.render import render
from robustflow.report.tables import tables_of
from robustflow.stats.flat_and_depth import TWINS, twin_comparisons
from tests.made_rows import made_run
from tests.refusals import refusal

from .simulated import rows_of

INCREASES = {"a": (1.0, 2.0), "b": (2.0, 1.0), "c": (3.0, 5.0), "d": (4.0, 4.0), "e": (5.0, 9.0)}
"""CRE in pixels under fog and fog_3d; the ranks are 1 2 3 4 5 and 2 1 4 3 5, so Spearman's rho is 1 - 6 * 4 / 120 =
0.8.
"""


@pytest.fixture(scope="module")
def runs(base):
    """Models on six pairs, whose CRE under fog_3d differs by 0.5 px."""
    made = []
    for name, (flat, deep) in INCREASES.items():
        cre = np.array([(0, flat, deep + spread) for spread in np.linspace(-0.25, 0.25, 6)])
        rows = rows_of(np.ones(6), 1 + cre, cre).filter(pl.col("severity") != 1)  # fog at 3 and snow at 2 remain
        twins = (pl.col("corruption").replace("snow", "fog_3d"), pl.col("severity").replace(2, 3))
        made.append(made_run(base, rows.with_columns(twins), name))
    return made


def test_differences_and_rank_correlation_are_those_of_the_errors(runs):
    (one,) = twin_comparisons(runs)
    assert (one.flat, one.deep, one.severities, one.metric, one.count) == ("fog", "fog_3d", (3,), "cre", 5)
    for model in one.models:
        flat, deep = INCREASES[model["model"]]
        assert (model["value_against"], model["value_model"], model["value"]) == pytest.approx(
            (flat, deep, deep - flat)
        )
        assert model["low"] < deep - flat < model["high"]
        assert model["high"] - model["low"] < 1
    assert one.rho == pytest.approx(0.8)
    assert one.interval[0] < 0.8 < one.interval[1]


def test_the_table_has_a_line_for_each_correlation_and_each_model(runs):
    (table,) = tables_of(runs, published=False, wanted=["flat-and-depth"])
    assert "+0.80" in render(table, "markdown")
    assert [line.label for line in table.sections[1].lines] == list(INCREASES)


def test_few_models_have_differences_and_no_correlation(runs):
    (one,) = twin_comparisons(runs[:2])
    assert (one.rho, one.interval, len(one.models)) == (None, None, 2)
    (table,) = tables_of(runs[:1], published=False, wanted=["flat-and-depth"])
    assert [bool(line.note) for line in table.sections[0].lines] == [True] * len(table.sections[0].lines)


def test_runs_that_differ_in_the_seed_are_compared_and_the_table_says_so(runs):
    other = made_run(runs[0], runs[0].rows, "f", seed=7)
    (table,) = tables_of([*runs, other], published=False, wanted=["flat-and-depth"])
    assert "seed 7" in table.remarks[-1]
    (alike,) = tables_of(runs, published=False, wanted=["flat-and-depth"])
    assert "seed" not in " ".join(alike.remarks)


def test_runs_without_twins_have_no_such_table(runs):
    alone = made_run(runs[0], runs[0].rows.filter(pl.col("corruption") != "fog_3d"))
    assert twin_comparisons([alone]) == []
    refusal(lambda: tables_of([alone], published=False, wanted=["flat-and-depth"]), UsageError, "--table")


def test_every_twin_of_a_corruption_in_depth_exists():
    for flat, deep in TWINS:
        assert flat in CORRUPTIONS.names()
        assert deep in FURTHER["depth"]
