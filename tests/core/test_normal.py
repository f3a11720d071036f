"""Compare normal numbers generated from bits with SciPy's quantile function."""

import numpy as np
from scipy.special import ndtri

from robustflow.core.rng import normals_from_bits


def test_normal_quantile_equals_scipy_from_the_centre_to_the_last_bit_of_the_tail():
    tail = (2.0 ** np.linspace(11, 63, 5001)).astype(np.uint64)
    centre = np.linspace(0, 2**64 - 2**12, 20001).astype(np.uint64)
    words = np.concatenate([tail, centre])
    p = ((words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    upper = ((~words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    expected = np.where(p < 0.5, ndtri(p), -ndtri(upper))
    np.testing.assert_allclose(normals_from_bits(words), expected, rtol=3e-15)


def test_normal_quantile_is_antisymmetric_in_its_bits():
    words = np.random.default_rng(0).integers(0, 2**64, 1000, dtype=np.uint64)
    assert (normals_from_bits(words) == -normals_from_bits(~words)).all()


def test_normal_quantile_is_monotone():
    words = np.sort(np.random.default_rng(1).integers(0, 2**64, 10_000, dtype=np.uint64))
    assert (np.diff(normals_from_bits(words)) > 0).all()
