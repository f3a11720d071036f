"""`Result.compare` returns the numbers of the paired test with the right signs, and displays them correctly."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.api import evaluate
from robustflow.core.errors import RunError, UsageError
from robustflow.report.comparison import Comparison
from robustflow.stats.uncertainty import compare_rows
from tests.made_rows import made_run

from ..stats.simulated import rows_of

_RNG = np.random.default_rng(0)
_HARD = _RNG.gamma(4, 0.25, 40)


def _rows(factor: float):
    """Forty images whose errors under corruption are `factor` times those of a second model."""
    corrupted = factor * np.array([3.0, 5.0, 10.0]) * _HARD[:, None] * _RNG.gamma(50, 1 / 50, (40, 3))
    return rows_of(2 * _HARD, corrupted, corrupted)


_BETTER, _WORSE = _rows(0.5), _rows(1.0)
_FOUND = Comparison(("a<b>", "b\x1b[31m"), compare_rows(_BETTER, _WORSE, ("a<b>", "b\x1b[31m"), resamples=499))


def test_comparison_holds_means_and_differences_per_corruption():
    overall = {(row["metric"], row["corruption"]): row for row in _FOUND.overall.iter_rows(named=True)}
    assert list(overall) == [("epe", "clean"), *((m, "average") for m in ("epe", "cre", "crer", "rcre"))]
    each = _FOUND.per_corruption("epe")
    assert each["corruption"].to_list() == ["fog", "snow"]
    for row in each.iter_rows(named=True):
        rows_of_both = (rows.filter(corruption=row["corruption"]) for rows in (_BETTER, _WORSE))
        expected = [(rows["epe_sum"] / rows["n_valid"]).mean() for rows in rows_of_both]
        assert row["value_first"] == pytest.approx(expected[0])
        assert row["difference"] == pytest.approx(expected[0] - expected[1])
        assert row["low"] < row["difference"] < row["high"] < 0
        assert row["p"] <= row["p_holm"] <= 1
    assert overall["epe", "clean"]["difference"] == 0
    with pytest.raises(UsageError, match="did you mean 'rcre'"):
        _FOUND.per_corruption("rcree")


def test_the_sentence_and_the_table_say_who_is_better():
    assert _FOUND.metric == "epe"
    for sentence in (_FOUND.sentence, _FOUND.table("cre").remarks[0]):
        assert sentence.endswith(": a<b> is lower.")
    shown = repr(_FOUND)
    assert "\x1b" not in shown
    assert "EPE (px) per corruption" in shown
    html = _FOUND._repr_html_()
    assert "<b>" in html  # the better value
    assert "a&lt;b&gt;" in html
    assert "a<b>" not in html
    assert "\x1b" not in html


def test_marks_follow_the_level():
    """499 resamples cannot resolve the level 0.999, so nothing is claimed or marked at that level."""
    for level, expected in ((0.95, True), (0.999, False)):
        found = Comparison(("a", "b"), compare_rows(_BETTER, _WORSE, ("a", "b"), level=level, resamples=499))
        cells = [cell for section in found.table().sections for line in section.lines for cell in line.cells]
        assert any(cell.best for cell in cells) == expected
        assert found.sentence.endswith(" is lower.") == expected


def test_comparison_without_ground_truth_is_in_rcre(runs_without_truth):
    found = runs_without_truth[0].compare(runs_without_truth[1])
    assert found.metric == "rcre"
    assert found.overall["metric"].to_list() == ["rcre"]
    assert found.table("cre").remarks == ("No CRE was measured in both runs.",)
    assert "Elastic transform" in repr(found)


def test_comparison_of_runs_is_antisymmetric(small_run, tmp_path):
    chosen = {"corruptions": ["contrast", "fog"], "severities": [1, 5]}
    first, second = small_run, evaluate("farneback", "demo", output=tmp_path / "f", **chosen)
    found = rf.compare(first, second, resamples=99)
    assert found.names == ("DIS", "Farneback")
    assert found.frame.equals(first.compare(second, resamples=99).frame)
    assert found.frame["difference"].to_list() == [
        -d for d in rf.compare(second, first, resamples=99).frame["difference"]
    ]
    for each in (found, first.compare(first)):
        assert not each.sentence.endswith(" is lower.")
    assert found.remark.startswith("Not ranked: Farneback, because its clean EPE of 25.52 px"), "nothing left out"
    part = second.rows.filter((pl.col("severity") == 0) | (pl.col("corruption") == "fog") & (pl.col("severity") == 5))
    assert "2 common rows (clean or corrupted pairs) out of 5 in DIS" in first.compare(made_run(second, part)).remark
    digest = pl.when(pl.col("severity") == 0).then("frames_digest").otherwise(pl.lit("other"))
    with pytest.raises(RunError, match="frames in 1"):
        first.compare(made_run(second, part.with_columns(frames_digest=digest)))
