"""Rows and means of corruptions that leave no ground truth."""

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.metrics import METRICS
from robustflow.metrics.regions import REGIONS
from robustflow.report.gallery.examples import example_cells
from robustflow.run.repeat import recheck

from ..refusals import refusal
from ..stats.simulated import intervals

NAMES = ["contrast", "elastic_transform", "fog:2+elastic_transform:1"]
WITHOUT = {"elastic_transform", "fog:2+elastic_transform:1", "rolls"}


class Rolls:
    """An own corruption that declares that it leaves no ground truth."""

    truth = "none"

    def draw(self, rng, severity, shape):
        return severity

    def apply(self, frame, state, index):
        return np.roll(frame, state, axis=1)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    output = tmp_path_factory.mktemp("truth") / "run"
    return rf.evaluate("dis", corruptions=[*NAMES, Rolls], severities=[1, 3], output=output)


def test_rows_of_corruptions_without_truth_have_rcre_but_no_errors(run):
    moved = run.rows.filter(pl.col("truth") == "none")
    assert set(moved["corruption"]) == WITHOUT
    of_truth = ["truth_digest", "n_truth", "n_valid", "epe_sum", "clean_epe_sum", "rcre_sum", "fl_count", "wauc_sum"]
    of_truth += [f"{name}_{region}" for name in ("n", "epe_sum", "rcre_sum") for region in REGIONS]
    assert all(moved[name].null_count() == moved.height for name in of_truth)
    assert (moved["n_all"] == moved["height"] * moved["width"]).all()
    assert (moved["rcre_all_sum"] > 0).all()


def test_no_mean_includes_corruptions_without_truth_beside_others(run):
    assert run.measured.averaged_over == ["contrast"]
    for metric in METRICS:
        assert run.mean(metric) == run.mean(metric, "contrast")
    for name in WITHOUT:
        assert [run.mean(metric, name) for metric in ("epe", "cre", "crer", "fl")] == [None] * 4
        assert run.mean("rcre", name) == run.mean("rcre_all", name) > 0


def test_intervals_and_examples_leave_out_corruptions_without_truth(run):
    table = intervals(run.rows)
    averages = {row["measure"]: row["value"] for row in table.filter(condition="average").iter_rows(named=True)}
    assert averages["rcre"] == pytest.approx(run.rcre)
    measured = set(table.filter(condition="elastic_transform")["measure"])
    assert measured == {"rcre"}
    assert {cell.corruption for cell in example_cells(run.rows)} == {"contrast"}


def test_a_recheck_finds_a_changed_truth(run):
    recheck(run.manifest.identity, run.rows)
    changed = run.rows.with_columns(truth=pl.lit("unchanged")).sort("corruption")
    culprit = "sample 'motorcycle', elastic_transform severity 1"
    refusal(lambda: recheck(run.manifest.identity, changed, seed=0), RunError, culprit)
