"""`Result.compare` returns the numbers of the paired test with the right signs, and displays them correctly."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.api import evaluate
from robustflow.core.errors import RunError, UsageError
from robustflow.report.comparison import Comparison
from robustflow.stats.estimate import cubes_of
from tests.made_rows import made_run
from tests.refusals import refusal

from ..stats.simulated import rows_of

_RNG = np.random.default_rng(0)
_HARD = _RNG.gamma(4, 0.25, 40)


def _rows(factor: float):
    """Forty images whose errors under corruption are `factor` times those of a second model."""
    corrupted = factor * np.array([3.0, 5.0, 10.0]) * _HARD[:, None] * _RNG.gamma(50, 1 / 50, (40, 3))
    return rows_of(2 * _HARD, corrupted, corrupted)


_NAMES = ("a<b>", "b\x1b[31m")
_BETTER, _WORSE = _rows(0.5), _rows(1.0)


def _compared() -> Comparison:
    return Comparison(cubes_of(dict(zip(_NAMES, (_BETTER, _WORSE), strict=True))))


def test_comparison_holds_means_and_differences_per_corruption():
    found = _compared()
    overall = {(row["measure"], row["condition"]): row for row in found.overall.iter_rows(named=True)}
    assert list(overall) == [("epe", "clean"), *((m, "average") for m in ("epe", "cre", "crer", "rcre"))]
    each = found.per_corruption("epe")
    assert each["condition"].to_list() == ["fog", "snow"]
    for row in each.iter_rows(named=True):
        rows_of_both = (rows.filter(corruption=row["condition"]) for rows in (_BETTER, _WORSE))
        expected = [(rows["epe_sum"] / rows["n_valid"]).mean() for rows in rows_of_both]
        assert row["value_model"] == pytest.approx(expected[0])
        assert row["value"] == pytest.approx(expected[0] - expected[1])
        assert row["low"] < row["value"] < row["high"] < 0
        assert row["p"] <= row["p_adjusted"] <= 1
    assert overall["epe", "clean"]["value"] == 0
    refusal(lambda: found.per_corruption("rcree"), UsageError, "rcree")


def test_lower_error_is_marked_and_claimed_where_a_test_shows_it():
    found = _compared()
    assert found.metric == "epe"
    assert [line.label for line in found.table().lines if line.cells[0].best] == ["EPE", "Fog", "Snow"]
    assert not any(line.cells[1].best for line in found.table().lines)
    assert "a<b> is lower" in found.sentence


def test_comparison_without_ground_truth_is_in_rcre(runs_without_truth):
    found = runs_without_truth[0].compare(runs_without_truth[1])
    assert found.metric == "rcre"
    assert found.overall["measure"].to_list() == ["rcre", "photometric", "photometric"]
    shown = [line.label for line in found.table("cre").lines]
    assert shown == ["RCRE", "clean photometric error", "photometric error"]
    assert "Elastic transform" in repr(found)


def test_comparison_of_runs_is_antisymmetric(small_run, tmp_path):
    chosen = {"corruptions": ["contrast", "fog"], "severities": [1, 5]}
    first, second = small_run, evaluate("farneback", "demo", output=tmp_path / "f", **chosen)
    found = rf.compare(first, second)
    assert found.names == ("DIS", "Farneback")
    assert found.frame.equals(first.compare(second).frame)
    opposite = rf.compare(second, first).frame["value"]
    assert found.frame["value"].to_list() == [-difference for difference in opposite]
    assert found.frame["p"].null_count() == found.frame.height, "one image is too few for a test"
    assert "Farneback" in found.remark, "it is not ranked"
    part = second.rows.filter((pl.col("severity") == 0) | (pl.col("corruption") == "fog") & (pl.col("severity") == 5))
    assert "2" in first.compare(made_run(second, part)).remark
    digest = pl.when(pl.col("severity") == 0).then("frames_digest").otherwise(pl.lit("other"))
    other = made_run(second, part.with_columns(frames_digest=digest), "Farneback")
    refusal(lambda: first.compare(other), RunError, "DIS and Farneback")
