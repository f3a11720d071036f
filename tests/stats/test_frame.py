"""The results frame has every number of its runs, once, and nothing that was not measured."""

from __future__ import annotations

import polars as pl
import pytest

import robustflow as rf
from robustflow.stats.attacks import attack_means
from robustflow.stats.frame import CONTRAST, KINDS, RESULTS_SCHEMA, results_frame
from robustflow.stats.intervals import interval_ends
from tests.made_rows import made_run

OF_TESTS = ("against", "p", "p_adjusted", "wins", "letter")
OPTIONS = {"corruptions": ["contrast", "fog"], "severities": [1, 5], "data_options": {"pairs": 6, "size": "64x96"}}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with a confidence and an attack."""
    folder = tmp_path_factory.mktemp("frame")
    more = {"confidence": "forward-backward", "attacks": ["random_sign"], "examples": False}
    return rf.evaluate("dis", "shapes", output=folder, progress=False, **OPTIONS, **more)


def test_frame_has_the_schema_and_each_number_once(run):
    frame = run.frame
    assert dict(frame.schema) == RESULTS_SCHEMA
    assert (
        frame.null_count()
        .select("benchmark", "model", "sample_set", "setting", "measure", "condition", "value", "pairs", "source")
        .row(0)
        == (0,) * 9
    )
    assert frame.select("measure", "condition", "severity").is_unique().all()
    assert frame.select("benchmark", "model", "setting", "source", "pairs").unique().rows() == [
        ("shapes", "DIS", "knowledge", "measured", 6)
    ]


def _numbers(frame: pl.DataFrame) -> dict:
    return {tuple(key): value for *key, value in frame.select("measure", "condition", "severity", "value").iter_rows()}


def test_numbers_are_those_of_the_run(run):
    assert _numbers(results_frame([run], ["means"], intervals=False)) == run.means
    found = _numbers(run.frame)
    known = attack_means(run)
    assert ("attack_linf", "random_sign", 5) in known
    assert known.items() <= found.items()


def test_intervals_are_beside_means_and_those_of_curves_beside_single_severities(run):
    frame = run.frame.filter(~pl.col("condition").str.starts_with("random_"))
    known = frame.drop_nulls("low").select("measure", "condition", "severity", "low", "high")
    assert {tuple(key): (low, high) for *key, low, high in known.iter_rows()} == interval_ends(run)
    assert {"epe", "fl", "log_ratio", "ause"} <= set(known.filter(pl.col("severity").is_null())["measure"])
    assert set(known.drop_nulls("severity")["measure"]) == {"epe", "rcre"}
    assert results_frame([run], intervals=False)["low"].null_count() == run.frame.height - 4  # of the attacks


def test_runs_of_one_frame_are_told_apart_and_kinds_are_parts(run):
    other = made_run(run, run.rows, "Other")
    frame = results_frame([run, other], intervals=False)
    assert frame["model"].unique(maintain_order=True).to_list() == ["DIS", "Other"]
    parts = [results_frame([run, other], [kind], intervals=False) for kind in KINDS]
    assert sum(part.height for part in parts) == frame.height
    assert all(part.height for part in parts)
    assert results_frame([]).is_empty()


def test_tests_of_runs_on_the_same_frames_are_rows_of_the_frame(run):
    """A model with 30 px more error under corruption, one with the same errors, and one on fewer frames."""
    corrupted = pl.when(pl.col("corruption") != "clean").then(30 * pl.col("n_valid")).otherwise(0)
    worse = run.rows.with_columns(epe_sum=pl.col("epe_sum") + corrupted)
    runs = [run, made_run(run, worse, "Worse"), made_run(run, run.rows, "Alike"), made_run(run, run.rows[:9], "Few")]
    frame = results_frame(runs, [*KINDS, CONTRAST], intervals=False)
    tests = frame.drop_nulls("against").filter(measure="epe", condition="average")
    assert tests.select("model", "against", "wins").rows() == [
        ("DIS", "Worse", 6),
        ("DIS", "Alike", 0),
        ("Worse", "Alike", 0),
    ]
    assert tests["value"].to_list() == pytest.approx([-30, 0, 30])
    assert (tests["p"] <= tests["p_adjusted"]).all()
    assert set(frame.drop_nulls("against")["measure"]) >= {"fl", "px1", "wauc", "photometric", "rcre"}
    letters = frame.drop_nulls("letter").select("model", "measure", "condition", "letter").rows()
    assert letters == [
        ("DIS", "epe", "average", "a"),
        ("Worse", "epe", "average", "b"),
        ("Alike", "epe", "average", "a"),
    ]
    assert (
        frame.filter(pl.col("against").is_null())
        .drop(OF_TESTS)
        .equals(results_frame(runs, intervals=False).drop(OF_TESTS))
    )
