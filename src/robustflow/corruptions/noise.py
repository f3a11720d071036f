"""Gaussian, shot and impulse noise (paper, appendix "Noise corruptions"), independent from frame to frame.

Sample s of a frame (row-major, channels last) is decided by lane s of the frame's hash words alone: 32-bit lanes for
Gaussian and shot noise, 16-bit lanes for impulse noise. So any part of a frame can be computed by itself, and nothing
but integers is compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from ..random.rng import Rng, hash64
from ..sample import Frame
from .base import Corruption
from .kernels.alias import alias_table, counts_from_cdf, height_bits, normal_cdf, poisson_cdf
from .kernels.rounding import to_bytes

_BLOCK = 256
"""Hash words computed at a time: they stay in the first-level cache, and their loop vectorises."""


@dataclass(frozen=True)
class NoiseState:
    """What a pair shares: the amount of noise. `stream` names the streams of its frames."""

    parameter: float
    stream: Rng

    def key(self, index: int) -> np.uint64:
        """The key of frame `index`."""
        return np.uint64(self.stream.spawn("frame", index).key)


class _Noise(Corruption):
    family = "noise"
    temporal = True

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoiseState:
        return NoiseState(float(self.parameter(severity)), rng)


class GaussianNoise(_Noise):
    """I + c n with n ~ N(0, 1) per sample, on [0, 1]; `severities` are c (paper, "Gaussian Noise").

    The noise is drawn as an integer number of grey levels, from the exact probabilities of the rounded normal
    distribution in units of 2**-23; what lies beyond +-255 saturates every sample and is lumped.
    `variant="reference"` cuts fractions of a grey level off instead of rounding, as the code does.
    """

    name = "gaussian_noise"
    paper_severities = (0.08, 0.12, 0.18, 0.26, 0.38)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        _add_noise(
            source.reshape(-1),
            gaussian_table(state.parameter, self.variant == "reference"),
            state.key(index),
            out.reshape(-1),
        )
        return out


class ShotNoise(_Noise):
    """n / c with n ~ Poisson(I c) per sample, I on [0, 1]; `severities` are c (paper, "Shot Noise").

    One alias table per grey level, exact in units of 2**-22. `variant="reference"` cuts fractions of a grey level off
    instead of rounding, as the code does.
    """

    name = "shot_noise"
    paper_severities = (60, 25, 12, 5, 3)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        tables, column_bits = shot_tables(state.parameter, self.variant == "reference")
        shift, height_shift = np.uint32(column_bits), np.uint32(32 - column_bits - height_bits(8))
        _replace_levels(source.reshape(-1), tables, shift, height_shift, state.key(index), out.reshape(-1))
        return out


class ImpulseNoise(_Noise):
    """A share of the samples becomes 0 or 255, each as likely; `severities` are the share (paper, "Impulse Noise").

    The paper replaces pixels, the code samples (each channel for itself): the default is the code,
    `variant="paper"` replaces all three channels of a pixel alike. The share is exact to 2**-16.
    """

    name = "impulse_noise"
    paper_severities = (0.03, 0.06, 0.09, 0.17, 0.27)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        pepper, both = np.uint16(round(state.parameter * 2**15)), np.uint16(round(state.parameter * 2**16))
        if self.variant == "paper":
            _impulse_pixels(source.reshape(-1, 3), pepper, both, state.key(index), out.reshape(-1, 3))
        else:
            _impulse_samples(source.reshape(-1), pepper, both, state.key(index), out.reshape(-1))
        return out


@lru_cache(maxsize=16)
def gaussian_table(scale: float, floor: bool = False) -> npt.NDArray[np.uint32]:
    """Alias table, uint32 (512,), of round(255 * scale * n) + 255 with n ~ N(0, 1), clipped to 0 .. 510."""
    total = 1 << (9 + height_bits(9))
    deviation = Decimal(repr(scale)) * 255
    offset = Decimal(0) if floor else Decimal("0.5")
    upper = [round(total * normal_cdf((k + offset) / deviation)) for k in range(256)]
    shift = int(floor)
    edges = [upper[k + shift] if k + shift >= 0 else total - upper[-k - 1] for k in range(-255, 255)]
    counts = [after - before for before, after in pairwise([0, *edges, total])]
    return alias_table(counts, column_bits=9, value_bits=9)


@lru_cache(maxsize=8)
def shot_tables(photons: float, floor: bool = False) -> tuple[npt.NDArray[np.uint32], int]:
    """Alias tables of the 256 grey levels, one after the other, uint32 (256 << column_bits,), and column_bits.

    Level v at `photons` per unit of light becomes min(255, 255 n / photons), rounded, n ~ Poisson(v / 255 * photons).
    """
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
    """The table with grey levels in place of the outcomes' numbers."""
    names = np.zeros(256, np.uint32)
    names[: levels.size] = levels
    return (table & np.uint32(0xFFFF0000)) | (names[(table >> 8) & 255] << np.uint32(8)) | names[table & 255]


@njit(cache=True, nogil=True)
def _add_noise(source: Any, table: Any, key: Any, out: Any) -> None:
    words = np.empty(_BLOCK, np.uint64)
    lanes = words.view(np.uint32)
    entries = np.empty(2 * _BLOCK, np.uint32)
    for start in range(0, source.size, 2 * _BLOCK):
        for i in range(_BLOCK):
            words[i] = hash64(key, np.uint64(start // 2 + i))
        s = source[start : start + 2 * _BLOCK]
        o = out[start : start + 2 * _BLOCK]
        for i in range(s.size):
            entries[i] = table[lanes[i] >> np.uint32(23)]
        for i in range(s.size):
            e = entries[i]
            primary = np.int32(e & np.uint32(511))
            alias = np.int32((e >> np.uint32(9)) & np.uint32(511))
            below = (e >> np.uint32(18)) > ((lanes[i] >> np.uint32(9)) & np.uint32(16383))
            value = np.int32(s[i]) + (primary if below else alias) - np.int32(255)
            o[i] = min(max(value, np.int32(0)), np.int32(255))


@njit(cache=True, nogil=True)
def _replace_levels(source: Any, tables: Any, column_bits: Any, height_shift: Any, key: Any, out: Any) -> None:
    words = np.empty(_BLOCK, np.uint64)
    lanes = words.view(np.uint32)
    entries = np.empty(2 * _BLOCK, np.uint32)
    for start in range(0, source.size, 2 * _BLOCK):
        for i in range(_BLOCK):
            words[i] = hash64(key, np.uint64(start // 2 + i))
        s = source[start : start + 2 * _BLOCK]
        o = out[start : start + 2 * _BLOCK]
        for i in range(s.size):
            column = lanes[i] >> (np.uint32(32) - column_bits)
            entries[i] = tables[(np.uint32(s[i]) << column_bits) | column]
        for i in range(s.size):
            e = entries[i]
            below = (e >> np.uint32(16)) > ((lanes[i] >> height_shift) & np.uint32(65535))
            o[i] = np.uint8(e) if below else np.uint8(e >> np.uint32(8))


@njit(cache=True, nogil=True)
def _impulse_samples(source: Any, pepper: Any, both: Any, key: Any, out: Any) -> None:
    words = np.empty(_BLOCK, np.uint64)
    lanes = words.view(np.uint16)
    for start in range(0, source.size, 4 * _BLOCK):
        for i in range(_BLOCK):
            words[i] = hash64(key, np.uint64(start // 4 + i))
        s = source[start : start + 4 * _BLOCK]
        o = out[start : start + 4 * _BLOCK]
        for i in range(s.size):
            u = lanes[i]
            o[i] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i])


@njit(cache=True, nogil=True)
def _impulse_pixels(source: Any, pepper: Any, both: Any, key: Any, out: Any) -> None:
    words = np.empty(_BLOCK, np.uint64)
    lanes = words.view(np.uint16)
    for start in range(0, source.shape[0], 4 * _BLOCK):
        for i in range(_BLOCK):
            words[i] = hash64(key, np.uint64(start // 4 + i))
        s = source[start : start + 4 * _BLOCK]
        o = out[start : start + 4 * _BLOCK]
        for i in range(s.shape[0]):
            for c in range(s.shape[1]):
                u = lanes[i]
                o[i, c] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i, c])
