"""Intervals contain the true value, and tests reject a true null hypothesis, at their nominal rates.

The true value is known because the images are drawn from a known population. The fast tests catch gross errors; the
slow ones measure the rates, with acceptance limits of 93 to 97 percent.
"""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.analysis.uncertainty import compare_rows, intervals
from robustflow.analysis.uncertainty.bootstrap import bootstrap
from robustflow.analysis.uncertainty.statistic import Mean, Statistic, Term

from .simulated import Truth, coverage, rows_of

LOW, HIGH = 93.0, 97.0


def _sizes(rng: np.random.Generator, clusters: int, images: int) -> np.ndarray:
    return np.ones(clusters, int) if images == 1 else rng.integers(images // 2, images * 3 // 2 + 1, clusters)


def _groups(sizes: np.ndarray) -> list[str]:
    return [f"sequence{index:03d}" for index in np.repeat(np.arange(len(sizes)), sizes)]


def _interval_coverage(
    truth: Truth, clusters: int, images: int, repeats: int, seed: int, resamples: int = 999
) -> dict[object, float]:
    def once(rng: np.random.Generator) -> dict[object, bool]:
        sizes = _sizes(rng, clusters, images)
        clean, corrupted = truth.draw(rng, sizes)
        rows = rows_of(clean, corrupted, corrupted, _groups(sizes) if images > 1 else None)
        found = intervals(rows, resamples=resamples, seed=int(rng.integers(2**31)))
        ends = {(row["metric"], row["corruption"]): (row["low"], row["high"]) for row in found.iter_rows(named=True)}
        return {key: ends[key][0] <= mean <= ends[key][1] for key, mean in truth.means.items()}

    return coverage(once, repeats, seed)


def _rejections(
    truth: Truth, clusters: int, images: int, repeats: int, seed: int, resamples: int = 999
) -> dict[object, float]:
    """Percentage of trials in which two models of equal quality are called significantly different at the 5 % level."""

    def once(rng: np.random.Generator) -> dict[object, bool]:
        sizes = _sizes(rng, clusters, images)
        hard = truth.difficulty(rng, sizes)
        runs = []
        for shape in (8, 3):
            # equal means, but the second varies more, so the differences are skewed
            clean = 2 * hard * rng.gamma(shape, 1 / shape, len(hard))
            corrupted = np.array([3, 5, 10]) * hard[:, None] * rng.gamma(shape, 1 / shape, (len(hard), 3))
            runs.append(rows_of(clean, corrupted, corrupted, _groups(sizes) if images > 1 else None))
        found = compare_rows(*runs, resamples=resamples, seed=int(rng.integers(2**31)))
        raw = {(row["metric"], row["corruption"]): row["p"] < 0.05 for row in found.iter_rows(named=True)}
        family = (found.filter(metric="epe")["p_holm"] < 0.05).any()
        return {key: raw[key] for key in (("epe", "average"), ("cre", "average"), ("crer", "average"))} | {
            "family": bool(family)
        }

    return coverage(once, repeats, seed)


def test_intervals_of_independent_images_cover_roughly():
    found = _interval_coverage(Truth(), clusters=40, images=1, repeats=80, seed=1, resamples=399)
    assert min(found.values()) >= 87, found


def test_the_paired_test_keeps_its_level_roughly():
    found = _rejections(Truth(), clusters=40, images=1, repeats=80, seed=3, resamples=399)
    assert max(found.values()) <= 13, found


@pytest.mark.slow
@pytest.mark.parametrize(("clusters", "seed"), [(20, 10), (50, 11), (200, 12)])
def test_coverage_for_independent_images(clusters, seed):
    found = _interval_coverage(Truth(), clusters, images=1, repeats=2000, seed=seed)
    assert all(LOW <= value <= HIGH for value in found.values()), found


@pytest.mark.slow
@pytest.mark.parametrize(("clusters", "seed"), [(5, 20), (10, 21), (20, 22), (40, 23)])
def test_coverage_for_clustered_images(clusters, seed):
    found = _interval_coverage(Truth(spread=0.4, within=0.4), clusters, images=20, repeats=1500, seed=seed)
    assert all(LOW <= value <= HIGH for value in found.values()), found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("clusters", "images", "seed"), [(20, 1, 30), (80, 1, 31), (200, 1, 32), (5, 20, 33), (12, 20, 34), (40, 20, 35)]
)
def test_level_of_the_paired_test(clusters, images, seed):
    truth = Truth() if images == 1 else Truth(spread=0.4, within=0.4)
    found = _rejections(truth, clusters, images, repeats=1500, seed=seed)
    assert max(found.values()) <= 7.0, found


_UNEQUAL = np.maximum(1, np.round(np.exp(np.random.default_rng(2).normal(1.2, 1.1, 34)))).astype(int)
"""Numbers of pairs in 34 sequences, 1 to 37 each."""


def _crer_coverage(spread: float, of_sequence: float, repeats: int, seed: int) -> dict[object, float]:
    """Coverage of CREr's interval, and of the interval without the logarithm, on the same samples.

    `of_sequence` is the sigma of the logarithm of the factor by which corruption multiplies a sequence's errors.
    """
    sequences = np.repeat(np.arange(len(_UNEQUAL)), _UNEQUAL)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.bincount(sequences, values, len(_UNEQUAL))[:, None]

    def once(rng: np.random.Generator) -> dict[object, bool]:
        hard = Truth(spread, within=0.4).difficulty(rng, _UNEQUAL)
        factor = np.exp(rng.normal(0, of_sequence, len(_UNEQUAL)) - of_sequence**2 / 2)[sequences]
        clean, corrupted = (mean * hard * rng.gamma(8, 1 / 8, len(hard)) for mean in (2, 7))
        count = sums(np.ones(len(hard)))
        means = (Mean(sums(errors), count, np.ones(1)) for errors in (factor * corrupted - clean, clean))
        statistics = dict.fromkeys(("log", "plain"), Statistic([Term(*means)]))
        made = bootstrap(statistics, len(_UNEQUAL), resamples=599, relative={"log"}, seed=int(rng.integers(2**31)))
        return {name: one.low <= 2.5 <= one.high for name, one in made.items()}

    return coverage(once, repeats, seed)


def test_interval_of_crer_over_unequal_sequences_covers_more_than_that_of_a_mean():
    found = _crer_coverage(0.7, 0.5, repeats=250, seed=40)
    assert found["log"] >= 93.5
    assert found["log"] >= found["plain"] + 1


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "of_sequence", "least"), [(0.5, 0.0, 94.5), (0.7, 0.5, 94.5), (1.0, 0.8, 93.0)])
def test_coverage_of_crer_over_unequal_sequences(spread, of_sequence, least):
    found = _crer_coverage(spread, of_sequence, repeats=2000, seed=41)
    assert least <= found["log"] <= HIGH, found
