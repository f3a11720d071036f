"""Generate standard normal numbers using only additions, multiplications, divisions and square roots.

The last bit of logarithms, sines and exponentials from libm (and numpy's vectorised versions) may differ between
machines, whereas IEEE 754 specifies the results of the four basic operations and the square root exactly. The quantile
function is algorithm AS 241, PPND16 (Wichura 1988, Applied Statistics 37:477), accurate to about one part in 10**16.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compiled import njit

_LN2 = 0.6931471805599453

# fmt: off
_CENTRE_NUMERATOR = (
    2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457,
    13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.387132872796366608,
)
_CENTRE_DENOMINATOR = (
    5226.495278852854561, 28729.085735721942674, 39307.89580009271061, 21213.794301586595867,
    5394.1960214247511077, 687.1870074920579083, 42.313330701600911252, 1.0,
)
_TAIL_NUMERATOR = (
    7.7454501427834140764e-4, 0.0227238449892691845833, 0.24178072517745061177, 1.27045825245236838258,
    3.64784832476320460504, 5.7694972214606914055, 4.6303378461565452959, 1.42343711074968357734,
)
_TAIL_DENOMINATOR = (
    1.05075007164441684324e-9, 5.475938084995344946e-4, 0.0151986665636164571966, 0.14810397642748007459,
    0.68976733498510000455, 1.6763848301838038494, 2.05319162663775882187, 1.0,
)
_FAR_NUMERATOR = (
    2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.0012426609473880784386, 0.026532189526576123093,
    0.29656057182850489123, 1.7848265399172913358, 5.4637849111641143699, 6.6579046435011037772,
)
_FAR_DENOMINATOR = (
    2.04426310338993978564e-15, 1.4215117583164458887e-7, 1.8463183175100546818e-5, 7.868691311456132591e-4,
    0.0148753612908506148525, 0.13692988092273580531, 0.59983220655588793769, 1.0,
)
# fmt: on


@njit(cache=True, nogil=True)
def normals_from_bits(bits: Any, out: Any) -> None:
    """Convert each 64-bit integer to a standard normal number: the quantile for p = (top 52 bits + 1/2) / 2**52.

    `bits` is uint64 (n,), and `out` is float64 (n,). A vectorised loop evaluates the central approximation (85 % of the
    distribution) for every integer; a second loop overwrites the values in the tails.
    """
    for i in range(bits.size):
        out[i] = _centre(_deviation(bits[i]))
    for i in range(bits.size):
        q = _deviation(bits[i])
        if abs(q) > 0.425:
            out[i] = _tail(q)


@njit(cache=True, nogil=True, inline="always")
def _deviation(word: Any) -> Any:
    """Return p - 1/2 exactly, as an odd multiple of 2**-53."""
    return (np.float64(np.int64(word >> np.uint64(12)) - np.int64(2**51)) + 0.5) * 2.0**-52


@njit(cache=True, nogil=True, inline="always")
def _horner7(x: Any, c: Any) -> Any:
    return ((((((c[0] * x + c[1]) * x + c[2]) * x + c[3]) * x + c[4]) * x + c[5]) * x + c[6]) * x + c[7]


@njit(cache=True, nogil=True, inline="always")
def _centre(q: Any) -> Any:
    r = 0.180625 - q * q
    return q * _horner7(r, _CENTRE_NUMERATOR) / _horner7(r, _CENTRE_DENOMINATOR)


@njit(cache=True, nogil=True)
def _tail(q: Any) -> Any:
    r = math.sqrt(-natural_log(0.5 - abs(q)))
    if r <= 5.0:
        z = _horner7(r - 1.6, _TAIL_NUMERATOR) / _horner7(r - 1.6, _TAIL_DENOMINATOR)
    else:
        z = _horner7(r - 5.0, _FAR_NUMERATOR) / _horner7(r - 5.0, _FAR_DENOMINATOR)
    return -z if q < 0.0 else z


@njit(cache=True, nogil=True)
def natural_log(x: Any) -> Any:
    """Return the natural logarithm of a float64 in (0, 1], accurate to a few ulp.

    The argument is scaled to [sqrt(1/2), sqrt(2)), where log(m) = 2 atanh((m - 1) / (m + 1)) converges like 0.03**k.
    """
    halvings = 0
    while x < 2.0**-16:
        x *= 65536.0
        halvings += 16
    while x < 0.7071067811865476:
        x *= 2.0
        halvings += 1
    s = (x - 1.0) / (x + 1.0)
    z = s * s
    series = 1.0 / 23.0
    series = series * z + 1.0 / 21.0
    series = series * z + 1.0 / 19.0
    series = series * z + 1.0 / 17.0
    series = series * z + 1.0 / 15.0
    series = series * z + 1.0 / 13.0
    series = series * z + 1.0 / 11.0
    series = series * z + 1.0 / 9.0
    series = series * z + 1.0 / 7.0
    series = series * z + 1.0 / 5.0
    series = series * z + 1.0 / 3.0
    series = series * z + 1.0
    return 2.0 * s * series - halvings * _LN2
