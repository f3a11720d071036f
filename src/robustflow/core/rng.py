"""A counter-based random number generator, with the same values on every machine: value `i` of stream `key` is a
hash of (key, i).

The only state is a position, so any number of threads can read a stream from any position in any order. Streams are
named by purpose (`Rng.of(seed, "fog", 3, "000010")`), so they do not depend on the order of creation. The hash consists
of two rounds of the 64-bit finaliser of MurmurHash3 as improved by Stafford ("variant 13", used by SplitMix64; Steele,
Lea and Flood 2014); the key is added before each round.

The last bit of logarithms, sines and exponentials from libm (and numpy's vectorised versions) may differ between
machines, whereas IEEE 754 specifies the results of the four basic operations and the square root exactly. Normal
numbers use only these; the quantile function is algorithm AS 241, PPND16 (Wichura 1988, Applied Statistics 37:477),
accurate to about one part in 10**16.
"""

from __future__ import annotations

import hashlib
from numbers import Integral
from typing import Any

import numpy as np
import numpy.typing as npt

from .compiled import inner, njit
from .errors import UsageError

Numbers = npt.NDArray[np.float64]

_LN2, _SQRT_HALF = 0.6931471805599453, 0.7071067811865476

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


def normals_from_bits(bits: npt.NDArray[np.uint64]) -> Numbers:
    """Convert each 64-bit integer to a standard normal number: the quantile for p = (top 52 bits + 1/2) / 2**52."""
    q = ((bits >> np.uint64(12)).astype(np.int64) - 2**51 + 0.5) * 2.0**-52  # p - 1/2, exact
    r = 0.180625 - q * q
    out = q * _horner7(r, _CENTRE_NUMERATOR) / _horner7(r, _CENTRE_DENOMINATOR)
    in_tail = np.abs(q) > 0.425
    out[in_tail] = _tail(q[in_tail])
    return out


def _tail(q: Numbers) -> Numbers:
    mantissa, exponent = np.frexp(0.5 - np.abs(q))
    low = mantissa < _SQRT_HALF
    r = np.sqrt(-log_of_scaled(np.where(low, 2.0 * mantissa, mantissa), low - exponent))
    near = _horner7(r - 1.6, _TAIL_NUMERATOR) / _horner7(r - 1.6, _TAIL_DENOMINATOR)
    far = _horner7(r - 5.0, _FAR_NUMERATOR) / _horner7(r - 5.0, _FAR_DENOMINATOR)
    return np.copysign(np.where(r <= 5.0, near, far), q)


def _horner7(x: Numbers, c: tuple[float, ...]) -> Numbers:
    return ((((((c[0] * x + c[1]) * x + c[2]) * x + c[3]) * x + c[4]) * x + c[5]) * x + c[6]) * x + c[7]


@inner
def natural_log(x: Any) -> Any:
    """Return the natural logarithm of a float64 in (0, 1], accurate to a few ulp; for use in compiled loops.

    >>> round(natural_log(0.5), 12)
    -0.69314718056
    """
    halvings = 0
    while x < 2.0**-16:
        x *= 65536.0
        halvings += 16
    while x < _SQRT_HALF:
        x *= 2.0
        halvings += 1
    return log_of_scaled(x, halvings)


@inner
def log_of_scaled(x: Any, halvings: Any) -> Any:
    """Return log(x / 2**halvings) for x in [sqrt(1/2), sqrt(2)), where log(x) = 2 atanh((x - 1) / (x + 1)) converges
    like 0.03**k; for numbers in compiled loops and for arrays.
    """
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


_MASK = (1 << 64) - 1
_ONE, _STEP = np.uint64(1), np.uint64(0x9E3779B97F4A7C15)
_27, _30, _31 = np.uint64(27), np.uint64(30), np.uint64(31)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(inline="always", cache=True, nogil=True)
def hash64(key: Any, counter: Any) -> Any:
    """Return 64 random bits for position `counter` of stream `key`; for use in compiled loops."""
    z = (counter + _ONE) * _STEP + key
    z = (z ^ (z >> _30)) * _FIRST
    z = (z ^ (z >> _27)) * _SECOND
    z = (z ^ (z >> _31)) + key
    z = (z ^ (z >> _30)) * _FIRST
    z = (z ^ (z >> _27)) * _SECOND
    return z ^ (z >> _31)


@njit(cache=True, nogil=True)
def fill_bits(key: Any, start: Any, out: Any) -> None:
    """Fill `out` (uint64) with the values at positions `start`, `start` + 1, ... of stream `key`; for use in compiled
    loops.
    """
    for i in range(out.size):
        out[i] = hash64(key, start + np.uint64(i))


def key_of(*parts: str | int) -> int:
    """Hash strings and integers to a 64-bit key; different tuples are encoded as different strings before hashing."""
    text = "\x1f".join(map(_encoded, parts))
    return int.from_bytes(hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=8).digest(), "little")


def check_seed(seed: Any) -> int:
    """Return a seed as an int; raise a UsageError if it is not a whole number.

    >>> check_seed(np.int64(3))
    3
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral):
        raise UsageError("seed", f"must be a whole number, not {seed!r}")
    return int(seed)


def _encoded(part: str | int) -> str:
    if isinstance(part, bool) or not isinstance(part, str | Integral):
        raise UsageError(f"{part!r:.60}", "the name of a random stream consists of texts and whole numbers")
    text = str(part)
    return f"{'str' if isinstance(part, str) else 'int'}:{len(text)}:{text}"


class Rng:
    """A named stream of random numbers.

    >>> a, b = Rng.of(0, "demo"), Rng.of(0, "demo")
    >>> a.uniform() == b.uniform()
    True
    >>> bool((a.spawn("x").bits(3) == b.spawn("y").bits(3)).any())
    False
    """

    def __init__(self, key: int) -> None:
        self.key = key & _MASK
        self._position = 0

    @classmethod
    def of(cls, *parts: str | int) -> Rng:
        """Return the stream named by `parts`, for example (seed, corruption, severity, sample key)."""
        return cls(key_of(*parts))

    def spawn(self, *parts: str | int) -> Rng:
        """Return a separate stream that does not depend on the current position of this stream."""
        return Rng(key_of(self.key, *parts))

    def bits(self, count: int) -> npt.NDArray[np.uint64]:
        """Return the next `count` random 64-bit integers, uint64 (count,)."""
        out = np.empty(count, np.uint64)
        fill_bits(np.uint64(self.key), np.uint64(self._position), out)
        self._position += count
        return out

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Return a uniformly distributed number in [low, high)."""
        return low + (high - low) * float(self.uniforms(1)[0])

    def uniforms(self, count: int) -> npt.NDArray[np.float64]:
        """Return `count` uniformly distributed multiples of 2**-53 in [0, 1), float64."""
        return (self.bits(count) >> np.uint64(11)).astype(np.float64) * 2.0**-53

    def integer(self, low: int, high: int) -> int:
        """Return a uniformly distributed integer from low to high - 1."""
        if high <= low:
            raise ValueError(f"no integer in [{low}, {high})")
        return low + ((int(self.bits(1)[0]) * (high - low)) >> 64)

    def normals(self, count: int) -> npt.NDArray[np.float64]:
        """Return `count` standard normal numbers, float64, one per position; they are bit-identical on every
        machine.
        """
        return normals_from_bits(self.bits(count))
