"""Rows and means of corruptions that leave no ground truth."""

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.corruptions.registry import MEMBERS
from robustflow.metrics import METRICS
from robustflow.metrics.regions import REGIONS
from robustflow.report.gallery.examples import example_cells
from robustflow.report.run_tables import corruptions_table
from robustflow.run.recheck import recheck
from robustflow.run.records.row_rules import broken_rules, row_rules
from robustflow.stats.audit import audit_results
from robustflow.stats.model_result import run_frame
from robustflow.stats.variance import variance_split

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


def test_the_table_shows_only_rcre_for_corruptions_without_truth(run):
    table = corruptions_table(run, "title")
    lines = {line.label: [cell.text for cell in line.cells] for section in table.sections for line in section.lines}
    shown = [column.label for column in table.columns]
    assert shown[:4] == ["EPE", "CRE", "CREr", "RCRE"]
    assert lines["elastic_transform"][:3] == lines["rolls"][:3]
    assert not any(text.strip("-–— ") for text in lines["elastic_transform"][:3])
    assert float(lines["elastic_transform"][3]) > 1


def test_the_variance_over_seeds_leaves_out_corruptions_without_truth(run):
    second = run.rows.with_columns(pl.col("rcre_sum", "rcre_all_sum") * 1.5, sample=pl.lit("b"), group=pl.lit("b"))
    rows = pl.concat([run.rows, second])
    contrast = rows.filter(pl.col("corruption").is_in(["clean", "contrast"]))
    splits = [variance_split(dict.fromkeys((0, 1), each), "rcre") for each in (rows, contrast)]
    assert splits[0].equals(splits[1])


def test_run_of_only_corruptions_without_truth_has_a_mean_rcre(tmp_path):
    alone = rf.evaluate("dis", corruptions=["elastic_transform"], severities=[1], output=tmp_path / "run")
    assert alone.epe is None
    assert alone.rcre == alone.mean("rcre", "elastic_transform") > 0
    assert alone.epe_clean > 0


@pytest.mark.parametrize(("corruption", "truth"), [("elastic_transform", "unchanged"), ("contrast", "none")])
def test_row_rules_find_rows_whose_errors_do_not_match_their_truth(run, corruption, truth):
    assert {broken.height for _, broken in broken_rules(run.rows, row_rules())} == {0}
    where = pl.col("corruption") == corruption
    rows = run.rows.with_columns(truth=pl.when(where).then(pl.lit(truth)).otherwise("truth"))
    broken = [set(found["corruption"]) for _, found in broken_rules(rows, row_rules()) if found.height]
    assert broken
    assert set.union(*broken) == {corruption}


def test_the_audit_of_results_expects_averages_without_these_corruptions(run):
    frame = run_frame([run])
    audit = audit_results(frame)
    assert (audit.checked["average"], audit.findings) == (4, [])
    rcre, average = pl.col("measure") == "rcre", pl.col("condition") == "average"
    mixed = frame.filter(rcre, ~average, ~pl.col("condition").is_in(list(MEMBERS)))["value"].mean()
    wrong = frame.with_columns(value=pl.when(rcre & average).then(mixed).otherwise("value"))
    assert [found.check for found in audit_results(wrong).findings] == ["average"]


def test_a_recheck_finds_a_changed_truth(run):
    recheck(run.manifest.identity, run.rows)
    changed = run.rows.with_columns(truth=pl.lit("unchanged")).sort("corruption")
    culprit = "sample 'motorcycle', elastic_transform severity 1"
    refusal(lambda: recheck(run.manifest.identity, changed, seed=0), RunError, culprit)
