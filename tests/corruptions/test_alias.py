"""Alias tables return every outcome with exactly the requested frequency; distributions agree with SciPy."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from robustflow.corruptions.kernels.alias import alias_table, counts_from_cdf, height_bits, normal_cdf, poisson_cdf

from .alias_counts import counts_of


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=64).filter(any))
def test_alias_table_gives_every_outcome_its_share(weights):
    total = 1 << (6 + height_bits(8))
    cdf = [Decimal(int(part)) / sum(weights) for part in np.cumsum(weights)]
    counts = counts_from_cdf(cdf, total)
    assert sum(counts) == total
    assert all(abs(count - total * weight / sum(weights)) <= 1 for count, weight in zip(counts, weights, strict=True))
    found = counts_of(alias_table(counts, 6, 8), 8)
    assert found[: len(counts)].tolist() == counts
    assert not found[len(counts) :].any()


def test_counts_that_do_not_fill_the_table_are_refused():
    with pytest.raises(ValueError, match="do not fill"):
        alias_table([1, 2, 3], 6, 8)


def test_normal_cdf_equals_scipy():
    xs = [Decimal(k) / 16 for k in range(-128, 129)]
    found = np.array([float(normal_cdf(x)) for x in xs])
    np.testing.assert_allclose(found, stats.norm.cdf([float(x) for x in xs]), rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("mean", [0, 1, 7.5, 60, 900])
def test_poisson_cdf_equals_scipy(mean):
    np.testing.assert_allclose(
        [float(p) for p in poisson_cdf(Decimal(mean), 100)],
        stats.poisson.cdf(np.arange(100), mean),
        rtol=1e-11,
        atol=1e-300,
    )
