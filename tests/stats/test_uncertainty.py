"""Intervals and tests are compared with formulas and a naive loop, including edge cases."""

from __future__ import annotations

import math

import numpy as np
import polars as pl
import pytest

from robustflow.core.errors import RunError
from robustflow.metrics.cube import Cube
from robustflow.metrics.measures import EVERY, MEASURES
from robustflow.run.summary import summarize
from robustflow.stats.estimate import contrast, estimate
from robustflow.stats.inference import (
    FEWEST,
    INCREASE_FLOOR,
    Scores,
    flip_test,
    mean_interval,
    ratio_interval,
)
from robustflow.stats.paired import difference_sentence, is_sure

from ..refusals import refusal
from .simulated import Truth, compare_all, compare_rows, intervals, rows_of


def _rows(count: int = 30, seed: int = 0, groups: int | None = None, shift: float = 0.0, digest: str = "d"):
    rng = np.random.default_rng(seed)
    clean, corrupted = Truth().draw(rng, np.ones(count, int))
    names = None if groups is None else [f"g{index % groups}" for index in range(count)]
    return rows_of(clean, corrupted + shift, corrupted, names, digest)


def test_estimates_are_the_means_of_the_summary():
    """Rows with gaps: one condition without ground truth, a missing condition, and a corruption that is not in the
    paper."""
    rows = _rows(12, groups=5)
    rows = rows.with_columns(
        n_valid=pl.when((pl.col("sample") == "00003") & (pl.col("corruption") == "fog")).then(0).otherwise("n_valid")
    ).filter(~((pl.col("sample") == "00007") & (pl.col("corruption") == "snow")))
    other = rows.filter(corruption="snow").with_columns(corruption=pl.lit("elastic_transform"))
    rows = pl.concat([rows, other])
    means, measured = summarize(rows)
    columns = intervals(rows, severities=True).select("measure", "condition", "severity", "value")
    found = {tuple(key): estimate for *key, estimate in columns.iter_rows()}
    shown = [("average", None), *((name, None) for name in measured.corruptions)]
    shown += [(name, level) for name, levels in measured.corruptions.items() for level in levels]
    keys = [("epe", "clean", None), *((metric, *at) for metric in ("epe", "cre", "crer", "rcre") for at in shown)]
    assert found == pytest.approx({key: means[key] for key in keys}, rel=1e-12)


@pytest.mark.parametrize("clusters", [24, 6, 2], ids=["independent images", "equal clusters", "two clusters"])
def test_the_standard_error_is_that_of_the_means_of_the_clusters(clusters):
    rows = _rows(24, groups=clusters)
    errors = rows.filter(corruption="clean").sort("sample")["epe_sum"].to_numpy() / 1000
    means = np.array([errors[g::clusters].mean() for g in range(clusters)])
    (found,) = intervals(rows).filter(measure="epe", condition="clean").to_dicts()
    assert found["standard_error"] == pytest.approx(means.std(ddof=1) / math.sqrt(clusters))
    assert (found["clusters"], found["pairs"]) == (clusters, 24)


def test_log_deviation_is_that_of_the_mean_errors_of_groups():
    errors = np.array([1.0, 2.0, 4.0, 8.0, 1.0, 1.0, 9.0])
    rows = rows_of(errors, np.outer(errors, np.ones(3)), np.zeros((7, 3)), ["a", "a", "b", "b", "c", "c", "unmeasured"])
    rows = rows.with_columns(n_valid=pl.when(pl.col("sample") == "00006").then(0).otherwise("n_valid"))
    found = {
        tuple(key): value for *key, value in intervals(rows).select("measure", "condition", "log_deviation").rows()
    }
    logs = [math.log(1.5), math.log(6), 0.0]
    expected = math.sqrt(sum((one - sum(logs) / 3) ** 2 for one in logs) / 2)
    assert found["epe", "clean"] == found["epe", "average"] == pytest.approx(expected)
    assert found["rcre", "average"] is None
    assert found["cre", "average"] is None


def test_log_deviation_of_a_group_without_error_is_unknown():
    errors = np.array([0.0, 2.0, 4.0, 8.0])
    found = intervals(rows_of(errors, np.outer(errors, np.ones(3)), np.zeros((4, 3))))
    assert found.filter(measure="epe")["log_deviation"].to_list() == [None] * found.filter(measure="epe").height


def test_order_of_rows_changes_nothing():
    rows = _rows(30, groups=9)
    shuffled = rows.sample(fraction=1, shuffle=True, seed=1)
    for column in ("value", "low", "high"):
        np.testing.assert_allclose(intervals(shuffled)[column], intervals(rows)[column], rtol=1e-12)


def test_averages_alone_and_a_family_of_one_corruption_have_the_intervals_of_the_whole():
    """Fog is the only weather corruption here, and there is no noise."""
    rows = _rows(10, groups=10).filter(pl.col("corruption") != "snow")
    whole, made = intervals(rows), intervals(rows, families=True)
    few = intervals(rows, corruptions=False)
    averages = whole.filter(pl.col("condition").is_in(["average", "clean"]))
    assert few.height == 5
    assert few.drop("standard_error", "low", "high").equals(averages.drop("standard_error", "low", "high"))
    for name in ("standard_error", "low", "high"):
        assert few[name].to_list() == pytest.approx(averages[name].to_list(), rel=1e-12)
    for name in ("value", "low"):
        of_family, of_one = (made.filter(condition=of).sort("measure")[name].to_list() for of in ("weather", "fog"))
        assert of_family == pytest.approx(of_one)
    assert made.filter(condition="noise").is_empty()


@pytest.mark.parametrize("clusters", [1, 2, 5, 6, 12])
def test_intervals_and_tests_need_six_clusters(clusters):
    rows, other = _rows(48, groups=clusters), _rows(48, groups=clusters, seed=1)
    found, tests = intervals(rows), compare_rows(rows, other)
    absent = found.height if clusters < FEWEST else 0
    assert [found[name].null_count() for name in ("value", "low", "high")] == [0, absent, absent]
    assert (found["low"] < found["value"]).all()  # where there is an interval
    assert (found["value"] < found["high"]).all()
    assert tests["p"].null_count() == tests["p_adjusted"].null_count() == tests["low"].null_count() == absent
    assert tests["wins"].null_count() == 0


@pytest.mark.parametrize("groups", [None, 45])
def test_equal_frames_under_several_names_are_one_cluster(groups):
    """Fifteen pairs under three names each count as fifteen, whatever their groups; means are those of all rows."""
    rows, other = (_rows(45, groups=groups, seed=seed) for seed in (0, 1))
    digest = pl.concat_str(pl.col("sample").cast(pl.Int64) % 15, "corruption", "severity")
    copies = [part.with_columns(frames_digest=digest) for part in (rows, other)]
    found, tests = intervals(copies[0]), compare_rows(*copies)
    assert set(found["clusters"]) == set(tests["clusters"]) == {15}
    assert set(found["pairs"]) == {45}
    assert found["value"].to_list() == intervals(rows)["value"].to_list()
    (sentence,) = map(difference_sentence, tests.filter(measure="epe", condition="average").iter_rows(named=True))
    assert "of 45 images in 15" in sentence
    unknown = rows.with_columns(frames_digest=pl.lit(""))
    assert set(intervals(unknown)["clusters"]) == {45}


def test_equal_images_have_no_interval():
    rows = rows_of(np.full(10, 2.0), np.full((10, 3), 3.0), np.full((10, 3), 1.5))
    found = intervals(rows).filter(measure="epe", condition="average").row(0, named=True)
    assert (found["value"], found["low"], found["high"]) == (pytest.approx(3.0), None, None)


def test_one_pair_of_numbers_a_cluster_is_all_that_intervals_and_tests_need():
    """Clusters of different sizes: each adds the sum of its images over the number of all images."""
    rows, other = _rows(30, groups=7), _rows(30, groups=7, seed=1)
    groups = rows.filter(corruption="clean").sort("sample")["group"].to_numpy()

    def scores(of_model: pl.DataFrame, condition: str) -> Scores:
        part = of_model.filter(corruption=condition).group_by("sample").agg((pl.col("epe_sum") / 1000).mean())
        errors = part.sort("sample")["epe_sum"].to_numpy()
        return Scores(
            *(np.array([part[groups == g].sum() for g in np.unique(groups)]) / 30 for part in (errors, 1 + 0 * errors))
        )

    line = intervals(rows).filter(measure="epe", condition="fog").row(0, named=True)
    ends = mean_interval(scores(rows, "fog"))
    assert (line["low"], line["high"]) == pytest.approx(tuple(map(float, ends)))
    clean, fog = scores(rows, "clean"), scores(rows, "fog")
    line = intervals(rows).filter(measure="cre", condition="fog").row(0, named=True)
    ends = mean_interval(fog - clean, floor=INCREASE_FLOOR)
    assert (line["low"], line["high"]) == pytest.approx(tuple(map(float, ends)))
    line = intervals(rows).filter(measure="crer", condition="fog").row(0, named=True)
    assert (line["low"], line["high"]) == pytest.approx(tuple(map(float, ratio_interval(fog - clean, clean))))
    test = compare_rows(rows, other).filter(measure="epe", condition="fog").row(0, named=True)
    assert test["p"] == float(flip_test((fog - scores(other, "fog")).num))
    test = compare_rows(rows, other).filter(measure="crer", condition="fog").row(0, named=True)
    both = [((scores(r, "fog") - scores(r, "clean")).num, scores(r, "clean").num) for r in (rows, other)]
    center = np.mean([above.sum() / below.sum() for above, below in both])
    left = [(above - center * below) / below.sum() for above, below in both]
    assert test["p"] == float(flip_test(left[0] - left[1]))
    assert test["value"] == pytest.approx((left[0] - left[1]).sum())


def test_rows_without_ground_truth_have_intervals_of_rcre_only():
    rows = _rows(10).with_columns(n_valid=pl.lit(None, pl.Int64), epe_sum=pl.lit(None, pl.Float64))
    found = intervals(rows)
    assert set(found["measure"]) == {"rcre"}
    assert intervals(rows.clear()).is_empty()


def test_a_model_does_not_differ_from_itself():
    rows = _rows(20)
    found = compare_rows(rows, rows)
    assert (found["value"] == 0).all()
    assert (found["p"] == 1).all()


def test_constant_difference_is_significant_and_has_no_interval():
    found = compare_rows(_rows(20), _rows(20, shift=0.5), ("A", "B"))
    line = found.filter(measure="epe", condition="average").row(0, named=True)
    assert line["value"] == pytest.approx(-0.5)
    assert (line["low"], line["wins"]) == (None, 20)
    assert line["p_adjusted"] < 0.01
    assert difference_sentence(line).endswith("A is lower.")
    clean = found.filter(measure="epe", condition="clean").row(0, named=True)
    assert clean["p"] == 1


def test_paired_test_finds_a_difference_where_single_intervals_overlap():
    """A small improvement on every image is detected, although the intervals of the two means overlap widely."""
    rng = np.random.default_rng(3)
    clean, corrupted = Truth(spread=1.0).draw(rng, np.ones(60, int))
    better = corrupted * rng.uniform(0.9, 0.98, corrupted.shape)
    a, b = rows_of(clean, corrupted, corrupted), rows_of(clean, better, better)
    line = compare_rows(a, b).filter(measure="epe", condition="average").row(0, named=True)
    assert line["p_adjusted"] < 0.01
    one, two = (intervals(rows).filter(measure="epe", condition="average").row(0, named=True) for rows in (a, b))
    assert two["high"] > one["low"]


def test_p_value_and_interval_of_the_ratio_agree_on_significance():
    for seed in range(12):
        rng = np.random.default_rng(seed)
        clean, corrupted = Truth().draw(rng, np.ones(25, int))
        other = corrupted * rng.lognormal(0.02, 0.2, corrupted.shape)
        found = compare_rows(rows_of(clean, corrupted, corrupted), rows_of(clean, other, other))
        tested = found.filter(pl.col("measure").is_in(["epe", "rcre"]), pl.col("condition") != "clean")
        assert tested.height == 6
        for row in tested.iter_rows(named=True):
            if abs(row["p"] - 0.05) > 0.001:
                assert (row["p"] < 0.05) == (row["ratio_low"] > 1 or row["ratio_high"] < 1), row


def test_half_the_error_on_every_image_is_told_apart_on_fifteen_images():
    """The symmetric bootstrap-t called it p = 0.695."""
    clean, corrupted = Truth(spread=1.2).draw(np.random.default_rng(5), np.ones(15, int))
    found = compare_rows(rows_of(clean / 2, corrupted / 2, corrupted), rows_of(clean, corrupted, corrupted), ("A", "B"))
    line = found.filter(measure="epe", condition="average").row(0, named=True)
    assert (line["wins"], line["p_adjusted"]) == (15, pytest.approx(0.0001, abs=1e-4))
    assert line["ratio"] == line["ratio_low"] == line["ratio_high"] == pytest.approx(0.5)
    assert difference_sentence(line).endswith("A is lower.")


def test_the_average_is_tested_by_itself_and_corruptions_together():
    found = compare_rows(_rows(20), _rows(20, seed=1))
    of_epe = found.filter(measure="epe").select("condition", "p", "p_adjusted", "comparisons")
    assert dict(of_epe.select("condition", "comparisons").rows()) == {"clean": 1, "average": 1, "fog": 2, "snow": 2}
    alone = of_epe.filter(comparisons=1)
    assert alone["p"].to_list() == pytest.approx(alone["p_adjusted"].to_list())


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_one_image_that_differs_is_no_evidence_of_a_difference(noise):
    rng = np.random.default_rng(12)
    errors = rng.lognormal(0, 0.5, (16, 3))
    other = errors + noise * rng.normal(size=(16, 3))
    other[7] = errors[7] + 400
    found = compare_rows(rows_of(np.ones(16), other, errors), rows_of(np.ones(16), errors, errors), ("A", "B"))
    line = found.filter(measure="epe", condition="average").row(0, named=True)
    assert line["value"] == pytest.approx(25, rel=1e-3)
    assert line["p"] > 0.9 if not noise else line["p"] > 0.2
    assert line["pairs"] - line["wins"] - line["losses"] == (0 if noise else 15)
    assert (line["blow_ups_model"], line["blow_ups_against"]) == (1, 0)
    assert not difference_sentence(line).endswith(" is lower.")


def test_blow_ups_are_counted_per_image_and_condition():
    errors = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0], [4.0, 4.0, 4.0], [1.0, 1.0, 1.0]])
    other = errors * np.array([[10.0, 10.0, 10.1], [1, 1, 30], [9, 9, 9], [0.05, 0.05, 0.05], [1, 1, 1]])
    one, two = rows_of(np.ones(5), other, errors), rows_of(np.ones(5), errors, errors)
    found = compare_rows(one, two).filter(measure="cre")
    counts = {name: tuple(ends) for name, *ends in found.select("condition", pl.col("^blow_ups.*$")).rows()}
    # average of image 1: (1 + 1) / 4 + 30 / 2 = 15.5 times
    assert counts == {"average": (2, 1), "fog": (0, 1), "snow": (2, 1)}
    assert dict(found.select("condition", "wins").rows()) == {"average": 1, "fog": 1, "snow": 1}
    without = [
        rows.with_columns(n_valid=pl.lit(None, pl.Int64), epe_sum=pl.lit(None, pl.Float64)) for rows in (one, two)
    ]
    assert compare_rows(*without)["blow_ups_model"].to_list() == [0, 0, 0]


def test_lines_without_a_test_are_not_counted_as_comparisons():
    """Snow was measured on two of twenty images, too few for a p-value."""
    few = (pl.col("corruption") != "snow") | (pl.col("sample") < "00002")
    found = compare_rows(*(_rows(20, seed=seed).filter(few) for seed in (0, 1)))
    assert found.filter(condition="snow", measure="rcre").select("p", "pairs", "clusters").row(0) == (None, 2, 2)
    assert set(found.drop_nulls("p")["comparisons"]) == {1}


@pytest.mark.parametrize(("shift", "sure"), [(0.004, False), (0.006, True)])
def test_a_difference_that_prints_as_0_carries_no_verdict(shift, sure):
    line = compare_rows(_rows(20, shift=shift), _rows(20), ("A", "B")).filter(measure="epe", condition="average")
    assert line["p_adjusted"].item() < 0.01
    assert is_sure(line.row(0, named=True)) == sure


@pytest.mark.filterwarnings("error")
def test_model_without_error_on_most_clean_images_is_compared_without_a_warning():
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(14, int))
    clean[1:] = 0
    found = compare_rows(rows_of(clean, corrupted, corrupted), rows_of(clean, corrupted + 1, corrupted))
    assert found.filter(measure="epe", condition="average")["value"].item() == pytest.approx(-1)


def test_only_what_both_measured_is_compared():
    found = compare_rows(_rows(20), _rows(15, shift=1.0).filter(pl.col("corruption") != "snow"))
    assert set(found["condition"]) == {"clean", "average", "fog"}
    assert set(found["pairs"]) == {15}


def test_image_without_a_prediction_of_one_model_is_left_out_of_both_means():
    lost = (pl.col("sample") < "00004") & (pl.col("corruption") != "snow")
    rows = _rows(20)
    blind = rows.with_columns(n_valid=pl.when(lost).then(0).otherwise("n_valid"))
    found = compare_rows(rows, blind)
    assert (found["value"] == 0).all()
    assert found.filter(condition="snow", measure="epe")["value_model"].item() == pytest.approx(
        intervals(rows).filter(condition="snow", measure="epe")["value"].item()
    )


def test_images_that_any_model_groups_are_one_cluster():
    """Images 2 k and 2 k + 1 are a group of one model, and 4 k to 4 k + 3 of the other."""
    rows = _rows(20, shift=0.5)
    halves, quarters = (
        rows.with_columns(group=pl.lit("g") + (pl.col("sample").cast(pl.Int64) // size).cast(pl.String))
        for size in (2, 4)
    )
    of_both = compare_rows(halves, quarters.with_columns(epe_sum=pl.col("epe_sum") + 1))
    assert set(of_both["clusters"]) == {5}
    assert of_both.equals(compare_rows(quarters, quarters.with_columns(epe_sum=pl.col("epe_sum") + 1)))
    assert set(compare_rows(rows, halves)["clusters"]) == {10}


@pytest.mark.parametrize("name", ["fl", "px1", "wauc", "photometric", "rcre_all", "coverage"])
def test_every_measure_has_an_interval_and_a_paired_test(name):
    """Percentages near the end of their range have intervals within it."""
    share = np.random.default_rng(1).beta(8, 1, 80)
    one, other = (
        _rows(20).with_columns(
            *(pl.Series(column, 1000 * part) for column in ("fl_count", "px1_count", "n_photometric")),
            *(pl.Series(column, 1000.0 * part) for column in ("wauc_sum", "photometric_sum", "rcre_all_sum")),
            n_truth=pl.Series(1000 / part),
        )
        for part in (share, share**2)
    )
    found = intervals(one, [name]).filter(condition="average")
    low, value, high = found.select("low", "value", "high").row(0)
    least, most = MEASURES[name].bounds
    if name == "photometric":
        assert (low, high) == (None, None), "all photometric errors are 1"
    else:
        assert least <= low < value < high <= most
    if name == "wauc":
        assert high - low < 20, "not a log interval, which reaches far below"
    test = compare_all({"a": one, "b": other}, name).row(0, named=True)
    assert (test["wins"], test["losses"])[MEASURES[name].better < 0] == (0 if name == "photometric" else 20)
    assert (test["p"] < 0.01) == (name != "photometric")


def test_median_has_a_value_and_wins_but_no_test():
    one, other = _rows(20), _rows(20, shift=1.0)
    median = {"median_cre": EVERY["median_cre"]}
    test = contrast({name: Cube.of(rows) for name, rows in (("a", one), ("b", other))}, median, [("average", None)])
    assert test.select("value", "p", "low", "wins").row(0) == (pytest.approx(-1.0), None, None, 20)
    assert estimate(Cube.of(one), median)["low"].null_count() == 3


def test_many_models_are_corrected_over_all_pairs():
    runs = {name: _rows(30, shift=shift) for name, shift in (("a", 0.0), ("b", 0.0), ("c", 1.0), ("d", 2.0))}
    found = compare_all(runs, "epe")
    assert found.height == 6
    assert set(found["comparisons"]) == {6}
    assert found.filter(model="a", against="b")["p_adjusted"].item() == 1
    assert (found.filter(against="d")["p_adjusted"] < 0.05).all()


ROWS = _rows(6)
UNMEASURED = ROWS.with_columns(pl.lit(0, pl.Int64).alias(name) for name in ("n_valid", "n_all"))
ELSEWHERE = _rows(6).with_columns(sample=pl.lit("x") + pl.col("sample"))
REFUSED = [
    (lambda: compare_rows(ROWS, UNMEASURED, ("A", "B")), RunError, "A and B"),
    (lambda: compare_rows(ROWS, _rows(6, digest="e")), RunError, "first and second"),
    (lambda: compare_rows(ROWS, ELSEWHERE), RunError, "first and second"),
]


@pytest.mark.parametrize(("call", "error", "culprit"), REFUSED)
def test_wrong_options_and_runs_that_cannot_be_compared_are_refused(call, error, culprit):
    refusal(call, error, culprit)


VERDICTS = [
    ({}, "A is lower."),
    ({"value": 0.4, "low": 0.1, "high": 0.7, "wins": 9, "losses": 71}, "B is lower."),
    ({"p_adjusted": 0.06}, "they cannot be told apart."),
    ({"low": None, "high": None}, "A is lower."),
    ({"low": -0.7, "high": 0.1}, "A is lower."),
    ({"p_adjusted": None}, "to tell them apart."),
    ({"value": -0.004}, "they cannot be told apart."),
]


@pytest.mark.parametrize(("changes", "verdict"), VERDICTS)
def test_verdict_follows_the_corrected_p_value(changes, verdict):
    row = {
        "model": "A",
        "against": "B",
        "measure": "cre",
        "condition": "fog",
        "value": -0.4,
        "low": -0.7,
        "ratio": None,
    }
    row |= {"high": -0.1, "p_adjusted": 0.02, "comparisons": 3, "pairs": 80, "clusters": 30, "wins": 71, "losses": 9}
    sentence = difference_sentence(row | changes)
    assert sentence.endswith(verdict)
    assert all(number in sentence for number in ("71 of 80", "30", f"{(row | changes)['value']:+.2f}"))
