"""Add Gaussian noise."""

from __future__ import annotations

from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.rng import fill_bits
from ...core.types import Frame
from ..kernels.alias import alias_table, height_bits, normal_cdf
from .noise import BLOCK, Noise, work_arrays


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
        """Write `source` plus Gaussian noise to `out`; see `Noise.add`."""
        table = gaussian_table(parameter, self.variant == "reference")
        _add_noise(source.reshape(-1), table, key, *work_arrays(np.uint32), out.reshape(-1))


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
def _add_noise(source: Any, table: Any, key: Any, words: Any, lanes: Any, entries: Any, out: Any) -> None:
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
            value = np.int32(s[i]) + (primary if below else alias) - np.int32(255)
            o[i] = min(max(value, np.int32(0)), np.int32(255))
