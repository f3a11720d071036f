"""Sample from a discrete distribution with one table lookup: Walker's alias method on integers.

A table has 2**b columns of equal height with at most two outcomes per column. The top b bits of a 32-bit random number
select the column, and the next bits select one of its outcomes. Probabilities are integer counts that sum to the number
of (column, height) positions, so the table is bit-identical on every machine.

Each entry contains the height of the primary outcome (highest bits), the alias outcome and the primary outcome (lowest
bits).
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from itertools import pairwise

import numpy as np
import numpy.typing as npt


def height_bits(value_bits: int) -> int:
    """Return the number of bits available for the height in a 32-bit entry with two outcomes of `value_bits` bits
    each.
    """
    return 32 - 2 * value_bits


def alias_table(counts: Sequence[int], column_bits: int, value_bits: int) -> npt.NDArray[np.uint32]:
    """Build the table, uint32 (2**column_bits,), in which outcome `i` occupies counts[i] positions."""
    columns, height = 1 << column_bits, 1 << height_bits(value_bits)
    left = list(counts) + [0] * (columns - len(counts))
    if len(left) != columns or sum(left) != columns * height or len(counts) > 1 << value_bits:
        raise ValueError(f"{len(counts)} counts (sum {sum(counts)}) do not fill {columns} columns of height {height}")
    primary, alias, level = [0] * columns, [0] * columns, [0] * columns
    small = [i for i, count in enumerate(left) if count < height]
    large = [i for i, count in enumerate(left) if count >= height]
    while small:
        low, high = small.pop(), large[-1]
        primary[low], alias[low], level[low] = low if low < len(counts) else 0, high, left[low]
        left[high] -= height - left[low]
        if left[high] < height:
            small.append(large.pop())
    for i in large:
        primary[i], alias[i] = i, i
    packed = (np.array(level, np.uint64) << np.uint64(2 * value_bits)) | (
        np.array(alias, np.uint64) << np.uint64(value_bits)
    )
    return (packed | np.array(primary, np.uint64)).astype(np.uint32)


def counts_from_cdf(cdf: Sequence[Decimal], total: int) -> list[int]:
    """Return integer counts whose cumulative sums are total * cdf, rounded to the nearest integer."""
    edges = [0, *(round(total * p) for p in cdf[:-1]), total]
    return [after - before for before, after in pairwise(edges)]


def normal_cdf(x: Decimal) -> Decimal:
    """Return P(N(0, 1) <= x) to about 20 digits, identical on every machine (Marsaglia 2004, J. Stat. Software
    11:4).
    """
    with localcontext(prec=40):
        if abs(x) > 10:
            return Decimal(int(x > 0))
        term = total = x
        k = 1
        while abs(term) > Decimal("1e-30"):
            k += 2
            term = term * x * x / k
            total += term
        return Decimal("0.5") + total * (-x * x / 2).exp() / (2 * _PI).sqrt()


def poisson_cdf(mean: Decimal, outcomes: int) -> list[Decimal]:
    """Return P(Poisson(mean) <= k) for k = 0 to outcomes - 1, identical on every machine."""
    with localcontext(prec=40):
        term = total = (-mean).exp()
        cdf = [total]
        for k in range(1, outcomes):
            term = term * mean / k
            total += term
            cdf.append(total)
        return cdf


_PI = Decimal("3.141592653589793238462643383279502884197")
