"""The results frame has every number of its runs, once, and nothing that was not measured."""

from __future__ import annotations

import polars as pl
import pytest

import robustflow as rf
from robustflow.stats.attacks import attack_scores
from robustflow.stats.frame import KINDS, RESULTS_SCHEMA, results_frame
from robustflow.stats.intervals import interval_ends
from tests.made_rows import made_run

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
        frame.null_count().select(pl.exclude("severity", "low", "high", "coverage", "decimals", "marked")).row(0)
        == (0,) * 12
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
    for score in attack_scores(run):
        at = score["attack"], score["severity"]
        assert found["rcre", *at] == score["rcre"]
        assert found["attack_linf", *at] == score["linf"]


def test_intervals_are_beside_the_means_over_severities(run):
    frame = results_frame([run], ["means"])
    known = frame.drop_nulls("low")
    ends = {(m, c): (low, high) for m, c, low, high in known.select("measure", "condition", "low", "high").iter_rows()}
    assert ends == interval_ends(run)
    assert known["severity"].null_count() == known.height
    assert results_frame([run], ["means"], intervals=False)["low"].null_count() == frame.height


def test_runs_of_one_frame_are_told_apart_and_kinds_are_parts(run):
    other = made_run(run, run.rows, "Other")
    frame = results_frame([run, other], intervals=False)
    assert frame["model"].unique(maintain_order=True).to_list() == ["DIS", "Other"]
    parts = [results_frame([run, other], [kind], intervals=False) for kind in KINDS]
    assert sum(part.height for part in parts) == frame.height
    assert all(part.height for part in parts)
    assert results_frame([]).is_empty()
