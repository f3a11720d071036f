"""Helpers for testing alias tables."""

import numpy as np

from robustflow.corruptions.kernels.alias import height_bits


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
