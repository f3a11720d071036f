"""Intervals and tests are compared with formulas and a naive loop, including edge cases."""

from __future__ import annotations

import math

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, false_discovery_control, t

from robustflow.core.errors import RunError, UsageError
from robustflow.metrics.cube import Cube
from robustflow.metrics.measures import EVERY, MEASURES
from robustflow.run.summary import summarize
from robustflow.stats.bootstrap import bootstrap, error_intervals, resampled_weights
from robustflow.stats.estimate import contrast, estimate
from robustflow.stats.paired import difference_sentence
from robustflow.stats.ranking import holm
from robustflow.stats.statistic import ErrorMean, Mean

from ..refusals import refusal
from .simulated import Truth, compare_all, compare_rows, intervals, mean_of, rows_of


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


FORMULAS = {
    "mean": lambda a, b, c, d: a,
    "ratio": lambda a, b, c, d: a / b,
    "difference of ratios": lambda a, b, c, d: a / b - c / d,
    "logarithm": lambda a, b, c, d: math.log(a / b + 1) if isinstance(a, float) else (a / b).log(plus=1),
}


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS)
@pytest.mark.parametrize("complete", [True, False])
def test_values_and_influence_equal_their_definition(formula, complete):
    """Compute the means from their definition, and the influence by finite differences of the weights."""
    rng, share, weights = np.random.default_rng(8), np.array([0.2, 0.3, 0.5]), np.array([1.0, 0, 2, 1, 0, 2])
    counts = [np.full((6, 3), 2.0) if complete else 1.0 + rng.integers(0, 3, (6, 3)) for _ in range(4)]
    totals = [count * rng.normal(5, 1, count.shape) for count in counts]

    def value(w: np.ndarray) -> float:
        return formula(*(float(share @ ((w @ total) / (w @ n))) for total, n in zip(totals, counts, strict=True)))

    means = (Mean(total, count, share) for total, count in zip(totals, counts, strict=True))
    found = formula(*(mean(weights[None]) for mean in means))
    assert found.theta[0] == pytest.approx(value(weights))
    slopes = [(value(weights + 1e-6 * one) - value(weights)) / 1e-6 for one in np.eye(6)]
    np.testing.assert_allclose(found.influence[0], slopes, atol=1e-5)
    squares = (weights * found.influence[0] ** 2).sum()
    assert found.standard_error[0] == pytest.approx(math.sqrt(6 / 5 * squares))


def test_scores_of_clusters_add_up_to_the_mean():
    """Some clusters lack images under some conditions, and clusters have different sizes."""
    rng, share = np.random.default_rng(3), np.array([0.25, 0.25, 0.5])
    number = rng.integers(0, 4, (9, 3)).astype(float)
    mean = Mean(number * rng.gamma(4, 1, (9, 3)), number, share)
    scores = mean.scores
    assert scores.mean == pytest.approx(mean(np.ones((1, 9))).value)
    assert scores.den.sum() == pytest.approx(1)


def test_a_resample_without_an_image_under_a_condition_averages_over_the_others():
    totals, counts = np.array([[2.0, 8], [3, 0], [5, 0]]), np.array([[1.0, 1], [1, 0], [1, 0]])
    found = Mean(totals, counts, np.array([0.5, 0.5]))(np.array([[0.0, 1, 2], [1, 1, 1]]))
    np.testing.assert_allclose(found.theta, [(3 + 2 * 5) / 3, ((2 + 3 + 5) / 3 + 8) / 2])
    unmeasured = Mean(np.zeros((3, 0)), np.zeros((3, 0)), np.zeros(0))
    assert bootstrap({0: unmeasured}, 3)[0].low is None


@pytest.mark.parametrize("clusters", [24, 6], ids=["independent images", "equal clusters"])
def test_the_standard_error_is_that_of_the_means_of_the_clusters(clusters):
    rows = _rows(24, groups=clusters)
    errors = rows.filter(corruption="clean").sort("sample")["epe_sum"].to_numpy() / 1000
    means = np.array([errors[g::clusters].mean() for g in range(clusters)])
    (found,) = intervals(rows).filter(measure="epe", condition="clean").to_dicts()
    assert found["standard_error"] == pytest.approx(means.std(ddof=1) / math.sqrt(clusters))
    assert (found["clusters"], found["pairs"]) == (clusters, 24)


def test_the_interval_is_nearly_students_for_normal_numbers():
    """For many symmetric values, bootstrap-t and Student's t agree."""
    values = np.random.default_rng(5).normal(10, 2, 400)
    one = bootstrap({0: mean_of(values)}, 400)[0]
    half = 1.966 * values.std(ddof=1) / 20
    assert one.high - one.low == pytest.approx(2 * half, rel=0.05)
    assert one.estimate == pytest.approx(values.mean())


@pytest.mark.parametrize(("clusters", "deviation"), [(13, 1.2), (40, 1.2), (5, 1.2), (80, 2.2)])
def test_intervals_of_epe_cre_and_crer_agree_with_a_loop(clusters, deviation):
    """Jackknife of the logarithms, raised to the variance of a log-normal upper half, times the pivots of the
    resamples, which are limited to a quantile of Student's t."""
    rng = np.random.default_rng(9)
    count = np.round(rng.lognormal(1, 0.5, clusters)) + 1
    clean = count * rng.lognormal(0, deviation, clusters)
    corrupted = clean * rng.lognormal(1, 0.4, clusters)
    epe, cre, before = (
        Mean(sums[:, None], count[:, None], np.ones(1)) for sums in (corrupted, corrupted - clean, clean)
    )
    means = {"epe": ErrorMean(epe), "cre": ErrorMean(cre, before), "crer": ErrorMean(cre, before, relative=True)}
    found = error_intervals(means, clusters, resamples=999)

    def logs(weights: np.ndarray) -> dict[str, float]:
        a, b, n = ((weights * each).sum() for each in (corrupted, clean, count))
        return {"epe": math.log(a / n), "before": math.log(b / n), "growth": math.log(a / b)}

    def spread(weights: np.ndarray) -> dict[str, float]:
        a, b, n = ((weights * each).sum() for each in (corrupted, clean, count))
        shares = {
            "epe": corrupted / a - count / n,
            "before": clean / b - count / n,
            "growth": corrupted / a - clean / b,
        }
        factor = clusters / (clusters - 1)
        return {name: math.sqrt(factor * (weights * each**2).sum()) for name, each in shares.items()}

    def rise(sums: np.ndarray) -> float:
        by_size = sorted((total / images, images) for total, images in zip(sums, count, strict=True))
        middle = next(k for k in range(clusters) if 2 * sum(n for _, n in by_size[: k + 1]) >= count.sum())
        upper = [(math.log(x / by_size[middle][0]) ** 2, n) for x, n in by_size[middle + 1 :]]
        square = sum(n * each for each, n in upper) / sum(n for _, n in upper)
        mean = sums.sum() / count.sum()
        sandwich = clusters / (clusters - 1) * ((sums / sums.sum() - count / count.sum()) ** 2).sum()
        assert mean > 0
        share = 30 / clusters if clusters > 30 else 1
        return max(0, (math.exp(min(square, 4)) - 1) * ((count / count.sum()) ** 2).sum() - sandwich) * share

    whole = logs(np.ones(clusters))
    without = [logs(np.arange(clusters) != left_out) for left_out in range(clusters)]
    errors = {name: math.sqrt((clusters - 1) * np.var([one[name] for one in without])) for name in whole}
    errors["epe"] = math.hypot(errors["epe"], math.sqrt(rise(corrupted)))
    errors["before"] = math.hypot(errors["before"], math.sqrt(rise(corrupted - clean)))
    most = t.ppf(0.995, clusters - 1)
    draws = {"epe": [], "cre": [], "crer": []}
    for weights in (drawn for block in resampled_weights(clusters, 999, 0) for drawn in block):
        one, error = logs(weights), spread(weights)
        pivot = {
            name: np.clip((one[name] - whole[name]) / error[name], -most, most) if error[name] > 1e-9
            else np.sign(one[name] - whole[name]) * most
            for name in whole
        }  # fmt: skip
        for sign in (-1, 1):
            size, before, growth = (np.exp(whole[name] + sign * pivot[name] * errors[name]) for name in whole)
            draws["epe"].append(size)
            draws["cre"].append(before * (growth - 1))
            draws["crer"].append(growth - 1)
    for name, values in draws.items():
        low, high = np.quantile(values, [0.025, 0.975], method="inverted_cdf")
        assert found[name].low is not None
        assert (found[name].low, found[name].high) == pytest.approx((low, high))


def test_interval_of_cre_from_rows_is_that_of_its_sums():
    """Ground truth is missing on one clean frame, so CRE is over fewer images than EPE."""
    rows = _rows(15, groups=13)
    rows = rows.filter(~((pl.col("sample") == "00003") & (pl.col("corruption") == "clean")))
    found = intervals(rows, resamples=199).filter(measure="cre", condition="snow").row(0, named=True)
    totals = {}
    for sample in sorted(set(rows["sample"]) - {"00003"}):
        before, after = (
            rows.filter(sample=sample, corruption=name).select(pl.col("epe_sum") / pl.col("n_valid")).item()
            for name in ("clean", "snow")
        )
        total = totals.setdefault(rows.filter(sample=sample)["group"][0], [0.0, 0.0, 0])
        for place, value in enumerate((after - before, before, 1)):
            total[place] += value
    sums = np.array([totals.get(group, [0.0, 0.0, 0]) for group in sorted(set(rows["group"]))])
    increase, before = (Mean(sums[:, [k]], sums[:, [2]], np.ones(1)) for k in (0, 1))
    expected = error_intervals({0: ErrorMean(increase, before)}, len(sums), resamples=199)[0]
    assert (found["low"], found["high"]) == pytest.approx((expected.low, expected.high))


def test_mean_that_one_image_decides_has_no_interval():
    """One of 16 errors is 400 px; without it, the mean would be 1 px."""
    errors = np.random.default_rng(14).lognormal(0, 0.3, 16)
    errors[3] = 400
    corrupted = np.outer(errors, np.ones(3))
    found = intervals(rows_of(np.ones(16), corrupted, corrupted)).filter(condition="average")
    assert found["value"].null_count() == 0
    assert found["low"].null_count() == found["high"].null_count() == found.height


def test_interval_of_errors_that_are_0_on_most_images_is_finite():
    """The logarithm of the median does not exist, so no log-normal upper half is assumed."""
    errors = np.array([0.0] * 12 + [1.0, 1.1, 0.9, 1.2, 1.0, 0.8])
    one = error_intervals({0: ErrorMean(mean_of(errors))}, 18)[0]
    assert 0.1 < one.low < errors.mean() < one.high < 1.0
    none = error_intervals({0: ErrorMean(mean_of(np.zeros(18)))}, 18)[0]
    assert (none.estimate, none.low, none.high) == (0.0, 0.0, 0.0)


def test_cre_of_a_model_without_error_on_clean_frames_has_the_interval_of_its_epe():
    errors = np.random.default_rng(11).lognormal(0, 1, (20, 3))
    found = intervals(rows_of(np.zeros(20), errors, errors)).filter(condition="average")
    ends = {metric: (low, high) for metric, low, high in found.select("measure", "low", "high").iter_rows()}
    assert ends["cre"] == pytest.approx(ends["epe"])
    assert found.filter(measure="epe")["low"].item() > 0


def test_cre_of_a_model_without_error_under_corruption_has_no_interval():
    errors = np.random.default_rng(12).lognormal(0, 1, 20)
    found = intervals(rows_of(errors, np.zeros((20, 3)), np.ones((20, 3)))).filter(condition="average")
    assert found.filter(measure="crer")["value"].item() == -1
    assert found["low"].is_null().to_list() == [metric == "cre" for metric in found["measure"]]


def test_log_deviation_is_that_of_the_mean_errors_of_groups():
    errors = np.array([1.0, 2.0, 4.0, 8.0, 1.0, 1.0])
    rows = rows_of(errors, np.outer(errors, np.ones(3)), np.zeros((6, 3)), ["a", "a", "b", "b", "c", "c"])
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


def test_equal_seeds_give_equal_intervals_and_different_seeds_close_ones():
    rows = _rows(30)
    first, again, other = (intervals(rows, seed=seed) for seed in (1, 1, 2))
    assert first.equals(again)
    assert not first.equals(other)
    np.testing.assert_allclose(first["low"], other["low"], rtol=0.05)


def test_order_of_rows_changes_nothing():
    rows = _rows(30, groups=9)
    shuffled = rows.sample(fraction=1, shuffle=True, seed=1)
    for column in ("value", "low", "high"):
        np.testing.assert_allclose(intervals(shuffled)[column], intervals(rows)[column], rtol=1e-12)


def test_blocks_of_resamples_change_nothing(monkeypatch):
    rows = _rows(30)
    whole = intervals(rows, resamples=500)
    monkeypatch.setattr("robustflow.stats.bootstrap.BLOCK", 30 * 37)
    np.testing.assert_allclose(intervals(rows, resamples=500)["low"], whole["low"], rtol=1e-12)


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


@pytest.mark.parametrize("clusters", [1, 2, 3, 4, 12])
def test_an_interval_exists_where_resamples_without_spread_are_rarer_than_the_tail(clusters):
    """With G clusters, G of the G ** G resamples consist of a single cluster."""
    found = intervals(_rows(40, groups=clusters))
    absent = 0 if clusters / clusters**clusters < 0.05 else found.height
    assert [found[name].null_count() for name in ("value", "low", "high")] == [0, absent, absent]
    assert (found["low"] < found["value"]).all()  # where there is an interval
    assert (found["value"] < found["high"]).all()


def test_equal_images_have_an_interval_without_width():
    rows = rows_of(np.full(10, 2.0), np.full((10, 3), 3.0), np.full((10, 3), 1.5))
    found = intervals(rows).filter(measure="epe", condition="average").row(0, named=True)
    assert found["low"] == found["high"] == pytest.approx(3.0)


def test_rows_without_ground_truth_have_intervals_of_rcre_only():
    rows = _rows(10).with_columns(n_valid=pl.lit(None, pl.Int64), epe_sum=pl.lit(None, pl.Float64))
    found = intervals(rows)
    assert set(found["measure"]) == {"rcre"}
    assert intervals(rows.clear()).is_empty()


def test_interval_at_a_higher_level_is_wider():
    rows = _rows(40)
    wide, narrow = intervals(rows, level=0.99), intervals(rows, level=0.8)
    assert (wide["low"] < narrow["low"]).all()
    assert (wide["high"] > narrow["high"]).all()


def test_a_model_does_not_differ_from_itself():
    rows = _rows(20)
    found = compare_rows(rows, rows)
    assert (found["value"] == 0).all()
    assert (found["p"] == 1).all()


def test_constant_difference_has_an_interval_without_width():
    found = compare_rows(_rows(20), _rows(20, shift=0.5), ("A", "B"))
    line = found.filter(measure="epe", condition="average").row(0, named=True)
    assert line["value"] == pytest.approx(-0.5)
    assert line["low"] == pytest.approx(-0.5)
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


def test_p_value_and_interval_agree_on_significance():
    for seed in range(12):
        rng = np.random.default_rng(seed)
        clean, corrupted = Truth().draw(rng, np.ones(25, int))
        other = corrupted * rng.lognormal(0.02, 0.2, corrupted.shape)
        found = compare_rows(
            rows_of(clean, corrupted, corrupted), rows_of(clean, other, other), resamples=999, seed=seed
        )
        for row in found.iter_rows(named=True):
            if abs(row["p"] - 0.05) > 0.01:
                assert (row["p"] < 0.05) == (row["low"] > 0 or row["high"] < 0), row


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_one_image_that_differs_is_no_evidence_of_a_difference(noise):
    """All differences are (nearly) 0 in the 36 % of the resamples that lack this image; the difference is larger,
    in standard errors, also in the resamples with this image three times or more."""
    rng = np.random.default_rng(12)
    errors = rng.lognormal(0, 0.5, (16, 3))
    other = errors + noise * rng.normal(size=(16, 3))
    other[7] = errors[7] + 400
    found = compare_rows(rows_of(np.ones(16), other, errors), rows_of(np.ones(16), errors, errors), ("A", "B"))
    line = found.filter(measure="epe", condition="average").row(0, named=True)
    assert line["value"] == pytest.approx(25, rel=1e-3)
    assert (line["low"], line["high"]) == (None, None)
    assert line["p"] == pytest.approx(binom.pmf(0, 16, 1 / 16) + binom.sf(2, 16, 1 / 16), abs=0.03)
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


def test_p_is_the_share_of_resamples_with_a_more_extreme_difference_in_standard_errors():
    rng = np.random.default_rng(13)
    differences = rng.normal(0.4, 1, 9)
    found = bootstrap({0: mean_of(differences)}, 9, resamples=399, seed=2)[0]
    observed, extreme = abs(differences.mean()) / differences.std(ddof=1) * 3, 0
    for weights in (drawn for block in resampled_weights(9, 399, 2) for drawn in block):
        drawn = np.repeat(differences, weights.astype(int))
        extreme += abs(drawn.mean() - differences.mean()) * 3 / drawn.std(ddof=1) >= observed
    assert 20 < extreme < 300
    assert found.p == (1 + extreme) / 400


def test_differences_that_cancel_have_a_p_value_of_1():
    assert bootstrap({0: mean_of(np.array([1.0, -1.0] * 5))}, 10)[0].p == 1


def test_lines_without_a_test_are_not_counted_as_comparisons():
    """Snow was measured on two of twenty images, too few for a p-value."""
    few = (pl.col("corruption") != "snow") | (pl.col("sample") < "00002")
    found = compare_rows(*(_rows(20, seed=seed).filter(few) for seed in (0, 1)))
    assert found.filter(condition="snow", measure="rcre").select("p", "pairs", "clusters").row(0) == (None, 2, 2)
    for _, lines in found.drop_nulls("p").group_by("measure"):
        assert lines["p_adjusted"].to_list() == pytest.approx(holm(lines["p"].to_list()))
        assert set(lines["comparisons"]) == {lines.height}


def test_the_interval_of_a_difference_is_symmetric():
    found = compare_rows(_rows(20), _rows(20, seed=1))
    np.testing.assert_allclose(found["high"] - found["value"], found["value"] - found["low"])


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
    assert (least <= low < value < high <= most) == (name != "photometric"), "all photometric errors are 1"
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


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_holm_correction_equals_its_definition(p_values):
    adjusted = holm(p_values)
    order = np.argsort(p_values, kind="stable")
    for rank, index in enumerate(order):
        steps = [min(1.0, (len(p_values) - j) * p_values[order[j]]) for j in range(rank + 1)]
        assert adjusted[index] == pytest.approx(max(steps))
        # never less strict than control of the false discovery rate, never stricter than Bonferroni
        assert adjusted[index] <= min(1.0, len(p_values) * p_values[index]) + 1e-12
    assert (np.array(adjusted) >= false_discovery_control(p_values) - 1e-9).all()


ROWS = _rows(6)
UNMEASURED = ROWS.with_columns(pl.lit(0, pl.Int64).alias(name) for name in ("n_valid", "n_all"))
ELSEWHERE = _rows(6).with_columns(sample=pl.lit("x") + pl.col("sample"))
REFUSED = [
    *((lambda level=level: intervals(ROWS, level=level), UsageError, "level") for level in (95, 0.2, 1.0)),
    (lambda: intervals(ROWS, resamples=10), UsageError, "resamples"),
    (lambda: compare_rows(ROWS, UNMEASURED, ("A", "B")), RunError, "A and B"),
    (lambda: compare_rows(ROWS, _rows(6, digest="e")), RunError, "first and second"),
    (lambda: compare_rows(ROWS, ELSEWHERE), RunError, "first and second"),
]


@pytest.mark.parametrize(("call", "error", "culprit"), REFUSED)
def test_wrong_options_and_runs_that_cannot_be_compared_are_refused(call, error, culprit):
    refusal(call, error, culprit)


VERDICTS = [
    ({}, "A is lower."),
    ({"value": 0.4, "low": 0.1, "high": 0.7}, "B is lower."),
    ({"p_adjusted": 0.06}, "they cannot be told apart."),
    ({"low": None, "high": None}, "they cannot be told apart."),
    ({"p_adjusted": None}, "too few to tell them apart."),
    ({"level": 0.99}, "they cannot be told apart."),
]


@pytest.mark.parametrize(("changes", "verdict"), VERDICTS)
def test_verdict_follows_the_corrected_p_value_and_the_interval(changes, verdict):
    row = {"model": "A", "against": "B", "measure": "cre", "condition": "fog", "value": -0.4, "low": -0.7}
    row |= {"high": -0.1, "p_adjusted": 0.02, "comparisons": 3, "pairs": 80, "clusters": 30, "level": 0.95}
    sentence = difference_sentence(row | changes)
    assert sentence.endswith(f": {verdict}")
    assert all(number in sentence for number in ("80", "30", f"{(row | changes)['value']:+.2f}"))
