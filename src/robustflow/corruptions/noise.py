"""Gaussian, shot and impulse noise, with one random stream per frame.

Sample s of a frame (row-major, channels last) depends only on lane s of the frame's hash values: 32-bit lanes for
Gaussian and shot noise, and 16-bit lanes for impulse noise. Any part of a frame can therefore be computed
separately, and only integers are compared.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit
from ..core.rng import Rng, fill_bits
from ..core.types import Frame
from .corruption import Corruption
from .kernels.alias import alias_table, counts_from_cdf, height_bits, normal_cdf, poisson_cdf
from .kernels.filters import to_bytes

BLOCK = 256
"""Number of hash values computed at a time, chosen so that they fit in the L1 cache and the loop vectorises."""


@dataclass(frozen=True)
class NoiseState:
    """State for a pair: the amount of noise and the parent of both frames' random streams."""

    parameter: float
    stream: Rng

    def key(self, index: int) -> np.uint64:
        """Return the key of the random stream for frame `index`."""
        return np.uint64(self.stream.spawn("frame", index).key)


class Noise(Corruption):
    """Base class for Gaussian, impulse and shot noise."""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoiseState:
        return NoiseState(float(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        self.add(source, state.parameter, state.key(index), out)
        return out

    @abstractmethod
    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        """Write `source` with noise to `out`; both arrays are contiguous."""


def work_arrays(lane: type[np.uint16 | np.uint32]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the work arrays of a compiled loop: `BLOCK` hash values, their lanes in the same memory, and one table
    entry for each lane. A loop that created them itself would take twice as long to compile.
    """
    words = np.empty(BLOCK, np.uint64)
    lanes = words.view(lane)
    return words, lanes, np.empty_like(lanes)


class GaussianNoise(Noise):
    """Adds Gaussian noise, I + c n with n ~ N(0, 1) per sample on [0, 1]; the severity parameter is c (paper, "Gaussian
    Noise").

    The noise is an integer number of grey levels sampled from a rounded normal distribution, whose probabilities are
    multiples of 2**-23; it is clipped to +-255, which already saturates any sample. `variant="reference"` truncates
    grey levels instead of rounding, as the reference code does.
    """

    name = "gaussian_noise"
    paper_severities = (0.08, 0.12, 0.18, 0.26, 0.38)

    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        table = gaussian_table(parameter, self.variant == "reference")
        _add_noise(source.reshape(-1), table, key, work_arrays(np.uint32), out.reshape(-1))


@lru_cache(maxsize=16)
def gaussian_table(scale: float, floor: bool = False) -> npt.NDArray[np.uint32]:
    """Return the alias table, uint32 (512,), for round(255 * scale * n) + 255 with n ~ N(0, 1), clipped to [0, 510]."""
    total = 1 << (9 + height_bits(9))
    deviation = Decimal(repr(scale)) * 255
    offset = Decimal(0) if floor else Decimal("0.5")
    upper = [round(total * normal_cdf((k + offset) / deviation)) for k in range(256)]
    shift = int(floor)
    edges = [upper[k + shift] if k + shift >= 0 else total - upper[-k - 1] for k in range(-255, 255)]
    counts = [after - before for before, after in pairwise([0, *edges, total])]
    return alias_table(counts, column_bits=9, value_bits=9)


@njit(cache=True, nogil=True)
def _add_noise(source: Any, table: Any, key: Any, work: Any, out: Any) -> None:
    """Draw each sample's noise by the alias method, 32 bits a sample, in blocks that fit the cache."""
    words, lanes, entries = work
    for start in range(0, source.size, 2 * BLOCK):
        fill_bits(key, np.uint64(start // 2), words)
        s = source[start : start + 2 * BLOCK]
        o = out[start : start + 2 * BLOCK]
        for i in range(s.size):
            entries[i] = table[lanes[i] >> np.uint32(23)]
        for i in range(s.size):
            e = entries[i]
            primary = np.int32(e & np.uint32(511))
            alias = np.int32((e >> np.uint32(9)) & np.uint32(511))
            below = (e >> np.uint32(18)) > ((lanes[i] >> np.uint32(9)) & np.uint32(16383))
            value = np.int32(np.int32(s[i]) + (primary if below else alias) - np.int32(255))
            o[i] = np.minimum(np.maximum(value, np.int32(0)), np.int32(255))


class ShotNoise(Noise):
    """Applies shot noise, n / c with n ~ Poisson(I c) per sample I on [0, 1]; the severity parameter is c (paper, "Shot
    Noise").

    Each grey level has an alias table, whose probabilities are multiples of 2**-22. `variant="reference"` truncates
    grey levels instead of rounding, as the reference code does.
    """

    name = "shot_noise"
    paper_severities = (60, 25, 12, 5, 3)

    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        tables, column_bits = shot_tables(parameter, self.variant == "reference")
        shift, height_shift = np.uint32(column_bits), np.uint32(32 - column_bits - height_bits(8))
        work = work_arrays(np.uint32)
        _replace_levels(source.reshape(-1), tables, shift, height_shift, key, work, out.reshape(-1))


@lru_cache(maxsize=8)
def shot_tables(photons: float, floor: bool = False) -> tuple[npt.NDArray[np.uint32], int]:
    """Return the concatenated alias tables for the 256 grey levels, uint32 (256 << column_bits,), and column_bits."""
    rate = Decimal(repr(photons))
    outcomes = int(np.ceil(photons)) + 1
    levels = to_bytes(np.arange(outcomes) / photons * 255.0, floor)
    column_bits = 6 if outcomes <= 64 else 8
    last = np.append(np.flatnonzero(np.diff(levels)), outcomes - 1)
    tables = []
    for level in range(256):
        cdf = poisson_cdf(rate * level / 255, outcomes)
        counts = counts_from_cdf([cdf[i] for i in last], 1 << (column_bits + height_bits(8)))
        tables.append(_relabel(alias_table(counts, column_bits, value_bits=8), levels[last]))
    return np.concatenate(tables), column_bits


def _relabel(table: npt.NDArray[np.uint32], levels: npt.NDArray[Any]) -> npt.NDArray[np.uint32]:
    """Replace the outcome indices in the tables with grey levels."""
    names = np.zeros(256, np.uint32)
    names[: levels.size] = levels
    return (table & np.uint32(0xFFFF0000)) | (names[(table >> 8) & 255] << np.uint32(8)) | names[table & 255]


@njit(cache=True, nogil=True)
def _replace_levels(
    source: Any, tables: Any, column_bits: Any, height_shift: Any, key: Any, work: Any, out: Any
) -> None:
    """Draw each sample from the alias table of its grey level, 32 bits a sample, in blocks that fit the cache."""
    words, lanes, entries = work
    for start in range(0, source.size, 2 * BLOCK):
        fill_bits(key, np.uint64(start // 2), words)
        s = source[start : start + 2 * BLOCK]
        o = out[start : start + 2 * BLOCK]
        for i in range(s.size):
            column = lanes[i] >> (np.uint32(32) - column_bits)
            entries[i] = tables[(np.uint32(s[i]) << column_bits) | column]
        for i in range(s.size):
            e = entries[i]
            below = (e >> np.uint32(16)) > ((lanes[i] >> height_shift) & np.uint32(65535))
            o[i] = np.uint8(e) if below else np.uint8(e >> np.uint32(8))


class ImpulseNoise(Noise):
    """Sets a fraction of the samples to 0 or 255 with equal probability (paper, "Impulse Noise").

    The severity parameter is the fraction, which is rounded to a multiple of 2**-16. The paper replaces entire pixels,
    whereas the reference code replaces each channel independently. The default follows the code; `variant="paper"`
    replaces all three channels of a pixel together.
    """

    name = "impulse_noise"
    paper_severities = (0.03, 0.06, 0.09, 0.17, 0.27)

    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        pepper, both = np.uint16(round(parameter * 2**15)), np.uint16(round(parameter * 2**16))
        words, lanes, _ = work_arrays(np.uint16)
        if self.variant == "paper":
            _impulse_pixels(source.reshape(-1, 3), pepper, both, key, words, lanes, out.reshape(-1, 3))
        else:
            _impulse_samples(source.reshape(-1), pepper, both, key, words, lanes, out.reshape(-1))


@njit(cache=True, nogil=True)
def _impulse_samples(source: Any, pepper: Any, both: Any, key: Any, words: Any, lanes: Any, out: Any) -> None:
    """Set samples (N,) to 0 below the threshold `pepper`, to 255 below `both`; 16 bits a sample."""
    for start in range(0, source.size, 4 * BLOCK):
        fill_bits(key, np.uint64(start // 4), words)
        s = source[start : start + 4 * BLOCK]
        o = out[start : start + 4 * BLOCK]
        for i in range(s.size):
            u = lanes[i]
            o[i] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i])


@njit(cache=True, nogil=True)
def _impulse_pixels(source: Any, pepper: Any, both: Any, key: Any, words: Any, lanes: Any, out: Any) -> None:
    """The same for whole pixels (N, 3), 16 bits a pixel."""
    for start in range(0, source.shape[0], 4 * BLOCK):
        fill_bits(key, np.uint64(start // 4), words)
        s = source[start : start + 4 * BLOCK]
        o = out[start : start + 4 * BLOCK]
        for i in range(s.shape[0]):
            for c in range(s.shape[1]):
                u = lanes[i]
                o[i, c] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i, c])
