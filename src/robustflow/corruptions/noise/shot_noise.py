"""Apply shot noise."""

from __future__ import annotations

from decimal import Decimal
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.rng import fill_bits
from ...core.types import Frame
from ..kernels.alias import alias_table, counts_from_cdf, height_bits, poisson_cdf
from ..kernels.values import to_bytes
from .noise import BLOCK, Noise, work_arrays


class ShotNoise(Noise):
    """Applies shot noise, n / c with n ~ Poisson(I c) per sample I on [0, 1]; the severity parameter is c (paper, "Shot
    Noise").

    Each grey level has an alias table, whose probabilities are multiples of 2**-22. `variant="reference"` truncates
    grey levels instead of rounding, as the reference code does.
    """

    name = "shot_noise"
    paper_severities = (60, 25, 12, 5, 3)

    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        """Replace each sample with a random photon count; see `Noise.add`."""
        tables, column_bits = shot_tables(parameter, self.variant == "reference")
        shift, height_shift = np.uint32(column_bits), np.uint32(32 - column_bits - height_bits(8))
        work = work_arrays(np.uint32)
        _replace_levels(source.reshape(-1), tables, shift, height_shift, key, *work, out.reshape(-1))


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
    source: Any,
    tables: Any,
    column_bits: Any,
    height_shift: Any,
    key: Any,
    words: Any,
    lanes: Any,
    entries: Any,
    out: Any,
) -> None:
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
