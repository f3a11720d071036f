"""Add impulse noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compiled import njit
from ...core.rng import fill_bits
from ...core.types import Frame
from .noise import BLOCK, Noise, work_arrays


class ImpulseNoise(Noise):
    """Sets a fraction of the samples to 0 or 255 with equal probability (paper, "Impulse Noise").

    The severity parameter is the fraction, which is rounded to a multiple of 2**-16. The paper replaces entire pixels,
    whereas the reference code replaces each channel independently. The default follows the code; `variant="paper"`
    replaces all three channels of a pixel together.
    """

    name = "impulse_noise"
    paper_severities = (0.03, 0.06, 0.09, 0.17, 0.27)

    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        """Replace samples; see `Noise.add`."""
        pepper, both = np.uint16(round(parameter * 2**15)), np.uint16(round(parameter * 2**16))
        words, lanes, _ = work_arrays(np.uint16)
        if self.variant == "paper":
            _impulse_pixels(source.reshape(-1, 3), pepper, both, key, words, lanes, out.reshape(-1, 3))
        else:
            _impulse_samples(source.reshape(-1), pepper, both, key, words, lanes, out.reshape(-1))


@njit(cache=True, nogil=True)
def _impulse_samples(source: Any, pepper: Any, both: Any, key: Any, words: Any, lanes: Any, out: Any) -> None:
    for start in range(0, source.size, 4 * BLOCK):
        fill_bits(key, np.uint64(start // 4), words)
        s = source[start : start + 4 * BLOCK]
        o = out[start : start + 4 * BLOCK]
        for i in range(s.size):
            u = lanes[i]
            o[i] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i])


@njit(cache=True, nogil=True)
def _impulse_pixels(source: Any, pepper: Any, both: Any, key: Any, words: Any, lanes: Any, out: Any) -> None:
    for start in range(0, source.shape[0], 4 * BLOCK):
        fill_bits(key, np.uint64(start // 4), words)
        s = source[start : start + 4 * BLOCK]
        o = out[start : start + 4 * BLOCK]
        for i in range(s.shape[0]):
            for c in range(s.shape[1]):
                u = lanes[i]
                o[i, c] = np.uint8(0) if u < pepper else (np.uint8(255) if u < both else s[i, c])
