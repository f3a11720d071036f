"""Log ratios, medians, the increase in Fl and partial correlations compared with float64 loops over images."""

from __future__ import annotations

import math
from statistics import fmean, median

import numpy as np
import polars as pl
import pytest
from scipy.stats import rankdata, spearmanr

from robustflow.metrics.measures import UNCOUPLED
from robustflow.metrics.rows import CLEAN
from robustflow.stats.numbers import uncoupled_means
from robustflow.stats.ranking import spearman

from .simulated import PIXELS, SETTINGS, rows_of


def _rows(seed: int, images: int) -> pl.DataFrame:
    """Image difficulty is shared by all conditions; motion and Fl differ by image and condition."""
    rng = np.random.default_rng(seed)
    hard = rng.gamma(2, 1, images) + 0.2
    corrupted = hard[:, None] * rng.gamma(3, 1, (images, 3))
    rows = rows_of(hard * rng.gamma(8, 1 / 8, images), corrupted, corrupted)
    motion = dict(
        zip(rows["sample"].unique(maintain_order=True), PIXELS * (hard + rng.gamma(2, 1, images)), strict=True)
    )
    return rows.with_columns(
        fl_count=pl.Series(rng.integers(0, PIXELS, rows.height)),
        magnitude_sum=pl.col("sample").replace_strict(motion, return_dtype=pl.Float64),
    )


def _naive(rows: pl.DataFrame) -> dict[str, float]:
    each = {(r["sample"], r["corruption"], r["severity"]): r for r in rows.to_dicts()}
    samples = sorted({sample for sample, _, _ in each})
    by_corruption: dict[str, list[tuple[float, ...]]] = {}
    for corruption, severity in SETTINGS:
        ratios, moves, outliers = [], [], []
        for sample in samples:
            row, clean = each[sample, corruption, severity], each[sample, CLEAN, 0]
            after, before = row["epe_sum"] / row["n_valid"], clean["epe_sum"] / clean["n_valid"]
            ratios.append(math.log(after / before))
            moves.append(after - before)
            outliers.append(100 * row["fl_count"] / row["n_valid"] - 100 * clean["fl_count"] / clean["n_valid"])
        found = fmean(ratios), median(ratios), median(moves), fmean(outliers)
        by_corruption.setdefault(corruption, []).append(found)
    means = [[fmean(column) for column in zip(*found, strict=True)] for found in by_corruption.values()]
    return dict(zip(UNCOUPLED, (fmean(column) for column in zip(*means, strict=True)), strict=True))


@pytest.mark.parametrize(("seed", "images"), [(0, 1), (1, 2), (2, 9), (3, 40)])
def test_scores_are_those_of_a_loop_over_images(seed, images):
    rows = _rows(seed, images)
    found = uncoupled_means(rows.sample(fraction=1, shuffle=True, seed=seed))
    for name, value in _naive(rows).items():
        assert found[name, "average", None] == pytest.approx(value, rel=1e-12, abs=1e-12)


def test_partial_correlation_is_that_of_what_the_motion_leaves():
    """The formula equals the correlation of the residuals of a least-squares fit of ranks."""
    rows = _rows(7, 40)
    corrupted = (
        rows.filter(pl.col("corruption") == "fog").group_by("sample").agg(pl.col("epe_sum").mean()).sort("sample")
    )
    clean = rows.filter(pl.col("corruption") == CLEAN).sort("sample")
    epe, before, motion = corrupted["epe_sum"], clean["epe_sum"], clean["magnitude_sum"]
    found = uncoupled_means(rows)
    rho, given_motion = found["rank_correlation", "fog", None], found["rank_correlation_given_motion", "fog", None]
    assert rho == pytest.approx(spearmanr(epe, before).statistic)
    fit = np.column_stack([np.ones(40), rankdata(motion)])
    rest = [rankdata(v) - fit @ np.linalg.lstsq(fit, rankdata(v), rcond=None)[0] for v in (epe, before)]
    assert given_motion == pytest.approx(np.corrcoef(*rest)[0, 1])
    assert abs(given_motion) < abs(rho)


def test_undefined_scores_are_left_out():
    rows = _rows(1, 6)
    no_truth = rows.with_columns(pl.lit(None, dtype=rows.schema[name]).alias(name) for name in ("n_valid", "epe_sum"))
    assert uncoupled_means(no_truth) == {}
    fewer = pl.when(pl.col("corruption") == "fog").then(PIXELS // 2).otherwise(pl.col("n_valid"))
    gaps = uncoupled_means(rows.with_columns(n_valid=fewer))
    assert ("fl_increase", "fog", None) not in gaps
    assert {("fl_increase", "snow", None), ("log_ratio", "fog", None)} <= {*gaps}
    first = pl.col("sample") == "00000"
    exact = rows.with_columns(clean_epe_sum=pl.when(first).then(0.0).otherwise(pl.col("clean_epe_sum")))
    found, of_others = uncoupled_means(exact), uncoupled_means(rows.filter(~first))
    assert found["log_ratio", "fog", 1] == of_others["log_ratio", "fog", 1]
    assert found["median_cre", "fog", 1] != of_others["median_cre", "fog", 1]
    equal = uncoupled_means(rows_of(np.ones(6), np.full((6, 3), 2.0), np.ones((6, 3))))
    for few in (uncoupled_means(_rows(1, 4)), equal):
        assert not {name for name, *_ in few} & {"rank_correlation", "rank_correlation_given_motion"}


@pytest.mark.parametrize("count", [5, 11, 200])
@pytest.mark.parametrize("slope", [-0.9, -0.3, 0.0, 0.3, 0.9])
def test_rank_correlation_is_that_of_scipy(count, slope):
    rng = np.random.default_rng(count)
    first = rng.permutation(count).astype(float)
    second = first * slope + rng.normal(0, count / 2, count)
    assert spearman(first, second) == pytest.approx(spearmanr(first, second).statistic, rel=1e-9)
