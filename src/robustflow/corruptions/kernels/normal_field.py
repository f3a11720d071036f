"""Generate fields of Gaussian noise with one table lookup per sample."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...random.normal import normals_from_bits
from ...random.rng import Rng, fill_bits

UNIT = 2.0**-12
"""Quantisation step of a field; samples are rounded to multiples of 1/4096."""


def normal_field(rng: Rng, height: int, width: int) -> npt.NDArray[np.int16]:
    """Generate independent standard normal samples, int16 (height, width) in units of `UNIT`."""
    out = np.empty((height, width), np.int16)
    words = np.empty(256, np.uint64)  # fits in the L1 cache
    _fill(np.uint64(rng.spawn("normal").key), quantiles(), words, words.view(np.uint16), out.reshape(-1))
    return out


@cache
def quantiles() -> npt.NDArray[np.int16]:
    """Return the quantiles of the normal distribution for the probabilities (i + 1/2) / 65536, int16 in units of
    `UNIT`.
    """
    normals = normals_from_bits((np.arange(65536, dtype=np.uint64) << np.uint64(48)) | np.uint64(1 << 47))
    return np.rint(normals / UNIT).astype(np.int16)


@njit(cache=True, nogil=True)
def _fill(key: Any, table: Any, words: Any, lanes: Any, out: Any) -> None:
    """Look up each of the four 16-bit lanes of every hash value; `lanes` are the same memory as `words`."""
    for start in range(0, out.size, lanes.size):
        fill_bits(key, np.uint64(start // 4), words)
        part = out[start : start + lanes.size]
        for i in range(part.size):
            part[i] = table[lanes[i]]
