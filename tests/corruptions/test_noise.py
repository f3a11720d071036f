"""Noise: exact distributions and tables, the generator lane used for each sample, and independence between frames."""

import numpy as np
import pytest
from scipy import stats

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions import load_corruption
from robustflow.corruptions.kernels.alias import alias_table, height_bits
from robustflow.corruptions.noise import gaussian_table, shot_tables


def counts_of(table, value_bits):
    """Count the number of table positions that lead to each outcome."""
    height = 1 << height_bits(value_bits)
    mask = (1 << value_bits) - 1
    out = np.zeros(1 << value_bits, np.int64)
    for entry in map(int, table):
        level = entry >> 2 * value_bits
        out[entry & mask] += level
        out[entry >> value_bits & mask] += height - level
    return out


def test_counts_that_do_not_fill_the_table_are_refused():
    with pytest.raises(ValueError):
        alias_table([1, 2, 3], 6, 8)


NAMES = ("gaussian_noise", "shot_noise", "impulse_noise")
SHAPE = (45, 67)
FRAME = np.random.default_rng(3).integers(0, 256, (*SHAPE, 3), dtype=np.uint8)


@pytest.mark.parametrize("floor", [False, True])
@pytest.mark.parametrize("scale", [0.003, *load_corruption("gaussian_noise").severities, 1.5])
def test_gaussian_table_holds_the_rounded_normal_distribution(scale, floor):
    edges = np.arange(-255, 255) + (1.0 if floor else 0.5)
    expected = np.diff(stats.norm.cdf(edges, scale=255 * scale), prepend=0, append=1)
    found = counts_of(gaussian_table(scale, floor), 9)[:511] / 2**23
    np.testing.assert_allclose(found, expected, atol=1.01 * 2**-23)


@pytest.mark.parametrize("floor", [False, True])
@pytest.mark.parametrize("photons", [*load_corruption("shot_noise").severities, 300, 7.3])
def test_shot_tables_hold_the_poisson_distributions(photons, floor):
    tables, column_bits = shot_tables(photons, floor)
    numbers = np.arange(0, int(np.ceil(photons)) + 1)
    levels = np.minimum(255, numbers / photons * 255)
    levels = (np.floor(levels) if floor else np.rint(levels)).astype(int)
    for grey in (0, 1, 17, 100, 254, 255):
        cdf = stats.poisson.cdf(numbers, grey / 255 * photons)
        cdf[-1] = 1
        expected = np.bincount(levels, np.diff(cdf, prepend=0), minlength=256)
        found = counts_of(tables[grey << column_bits : (grey + 1) << column_bits], 8)
        np.testing.assert_allclose(found / 2 ** (column_bits + 16), expected, atol=1.01 * 2**-22)


def random_bits(key, sample, bits):
    per_word = 64 // bits
    return int(hash64(key, np.uint64(sample // per_word))) >> bits * (sample % per_word) & (1 << bits) - 1


def naive_sample(name, state, key, sample, value):
    if name == "impulse_noise":
        u = random_bits(key, sample, 16)
        return 0 if u < round(state.parameter * 2**15) else 255 if u < round(state.parameter * 2**16) else value
    u = random_bits(key, sample, 32)
    if name == "gaussian_noise":
        entry = int(gaussian_table(state.parameter)[u >> 23])
        noise = entry & 511 if (u >> 9 & 16383) < entry >> 18 else entry >> 9 & 511
        return min(max(value + noise - 255, 0), 255)
    tables, column_bits = shot_tables(state.parameter)
    entry = int(tables[(value << column_bits) + (u >> (32 - column_bits))])
    return entry & 255 if (u >> (16 - column_bits) & 65535) < entry >> 16 else entry >> 8 & 255


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("severity", [1, 5])
def test_noise_of_every_sample_equals_the_naive_loop(name, severity):
    corruption = load_corruption(name)
    state = corruption.draw(Rng.of("naive", severity), severity, SHAPE)
    for index in (0, 1):
        found = corruption.apply(FRAME, state, index).reshape(-1)
        key = state.key(index)
        for sample in range(0, FRAME.size, 13):
            assert found[sample] == naive_sample(name, state, key, sample, int(FRAME.reshape(-1)[sample]))
