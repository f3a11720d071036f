"""Log ratios, medians, the increase in Fl and partial correlations compared with float64 loops over images."""

from __future__ import annotations

import math
from statistics import fmean, median

import numpy as np
import polars as pl
import pytest
from scipy.stats import rankdata, spearmanr

from robustflow.core.errors import UsageError
from robustflow.metrics.rows import CLEAN
from robustflow.stats.ranking import spearman
from robustflow.stats.uncoupled import UNCOUPLED, UncoupledScores, coupling, uncoupled

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


def _naive(rows: pl.DataFrame) -> UncoupledScores:
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
    return UncoupledScores(*(fmean(column) for column in zip(*means, strict=True)))


@pytest.mark.parametrize(("seed", "images"), [(0, 1), (1, 2), (2, 9), (3, 40)])
def test_scores_are_those_of_a_loop_over_images(seed, images):
    rows = _rows(seed, images)
    found, expected = uncoupled(rows.sample(fraction=1, shuffle=True, seed=seed)), _naive(rows)
    for name in UNCOUPLED:
        assert getattr(found.overall, name) == pytest.approx(getattr(expected, name), rel=1e-12, abs=1e-12)
        table = found.table(name)
        assert table.columns == ["corruption", "1", "2", "3", "mean"]
        assert fmean(table["mean"]) == pytest.approx(getattr(expected, name), rel=1e-12, abs=1e-12)
        assert table.row(0)[1:4:2] == tuple(getattr(found.by_condition[table.row(0)[0], s], name, None) for s in (1, 3))
    with pytest.raises(UsageError, match="unknown metric 'epe'"):
        found.table("epe")


def test_log_ratio_of_a_k_fold_error_is_ln_k_at_any_accuracy():
    """When the errors of two models double under corruption, CRE calls the less accurate one less robust by a factor
    of four.
    """
    hard = np.random.default_rng(5).gamma(2, 1, 30) + 0.1
    for scale in (1.0, 4.0):
        rows = rows_of(scale * hard, 2 * scale * hard[:, None] * np.ones(3), hard[:, None] * np.ones(3))
        found = uncoupled(rows).overall
        assert found.log_ratio == pytest.approx(math.log(2)) == found.median_log_ratio
        assert found.median_cre == pytest.approx(scale * np.median(hard))


def test_the_partial_correlation_is_that_of_what_the_motion_leaves():
    """The formula equals the correlation of the residuals of a least-squares fit of ranks."""
    rows = _rows(7, 40)
    corrupted = (
        rows.filter(pl.col("corruption") == "fog").group_by("sample").agg(pl.col("epe_sum").mean()).sort("sample")
    )
    clean = rows.filter(pl.col("corruption") == CLEAN).sort("sample")
    epe, before, motion = corrupted["epe_sum"], clean["epe_sum"], clean["magnitude_sum"]
    found = uncoupled(rows).correlation["fog"]
    assert found.images == 40
    assert found.rho == pytest.approx(spearmanr(epe, before).statistic)
    fit = np.column_stack([np.ones(40), rankdata(motion)])
    rest = [rankdata(v) - fit @ np.linalg.lstsq(fit, rankdata(v), rcond=None)[0] for v in (epe, before)]
    assert found.given_motion == pytest.approx(np.corrcoef(*rest)[0, 1])
    assert abs(found.given_motion) < abs(found.rho)


def test_undefined_scores_are_none():
    rows = _rows(1, 6)
    no_truth = rows.with_columns(pl.lit(None, dtype=rows.schema[name]).alias(name) for name in ("n_valid", "epe_sum"))
    assert uncoupled(no_truth).overall == UncoupledScores()
    fewer = pl.when(pl.col("corruption") == "fog").then(PIXELS // 2).otherwise(pl.col("n_valid"))
    gaps = uncoupled(rows.with_columns(n_valid=fewer))
    assert gaps.corruptions["fog"].fl_increase is None is not gaps.corruptions["snow"].fl_increase
    assert gaps.corruptions["fog"].log_ratio is not None
    exact = rows.with_columns(
        clean_epe_sum=pl.when(pl.col("sample") == "00000").then(0.0).otherwise(pl.col("clean_epe_sum"))
    )
    assert uncoupled(exact).left_out == 3
    assert not uncoupled(_rows(1, 4)).correlation, "too few images"
    equal = uncoupled(rows_of(np.ones(6), np.full((6, 3), 2.0), np.ones((6, 3)))).correlation["fog"]
    assert (equal.rho, equal.given_motion) == (None, None)


def test_noise_in_the_clean_error_correlates_ratio_and_clean_error_over_models():
    """In models that differ only by noise in their clean error, CRE seems to fall as this error grows, because CRE
    contains -EPE_clean.
    """
    clean = np.random.default_rng(2).gamma(20, 0.1, 30)
    found = coupling(clean, 7 - clean, np.log(7 / clean))
    assert found.cre == pytest.approx(-1.0) == found.log_ratio
    proportional = coupling(clean, 2 * clean, np.full(30, math.log(3)))
    assert (proportional.cre, proportional.log_ratio) == (pytest.approx(1.0), None)


@pytest.mark.parametrize("count", [5, 11, 200])
@pytest.mark.parametrize("slope", [-0.9, -0.3, 0.0, 0.3, 0.9])
def test_rank_correlation_is_that_of_scipy(count, slope):
    rng = np.random.default_rng(count)
    first = rng.permutation(count).astype(float)
    second = first * slope + rng.normal(0, count / 2, count)
    assert spearman(first, second) == pytest.approx(spearmanr(first, second).statistic, rel=1e-9)
