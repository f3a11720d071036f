"""A counter-based random number generator: value `i` of stream `key` is a hash of (key, i).

The only state is a position, so any number of threads can read a stream from any position in any order. The values are
the same on every machine: all arithmetic is on 64-bit integers, the conversion to floating point is exact, and normal
numbers only require operations whose results are fully specified by IEEE 754. Streams are named by purpose
(`Rng.of(seed, "fog", 3, "000010")`), so they do not depend on the order of creation.

The hash consists of two rounds of the 64-bit finaliser of MurmurHash3 as improved by Stafford ("variant 13", used by
SplitMix64; Steele, Lea and Flood 2014); the key is added before each round.
"""

from __future__ import annotations

import hashlib
from numbers import Integral
from typing import Any

import numpy as np
import numpy.typing as npt

from ..compiled import njit
from ..errors import UsageError
from .normal import normals_from_bits

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
        raise UsageError(f"a seed must be a whole number, not {seed!r}")
    return int(seed)


def _encoded(part: str | int) -> str:
    if isinstance(part, bool) or not isinstance(part, str | Integral):
        raise UsageError(f"the name of a random stream consists of texts and whole numbers, not {part!r:.60}")
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
