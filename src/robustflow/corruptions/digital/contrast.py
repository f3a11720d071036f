"""Reduce the contrast."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiled import njit
from ...sample import Frame
from ..base import Corruption
from ..kernels.rounding import to_bytes


class Contrast(Corruption):
    """Reduces the contrast: out = (I - mean) c + mean; the severity parameter is c (paper, "Contrast").

    The mean is computed per channel, as in the reference code; `variant="paper"` uses one mean for the entire frame, as
    in the paper's formula. `variant="reference"` truncates grey levels, as the reference code does.
    """

    name = "contrast"
    family = "digital"
    paper_severities = (0.4, 0.3, 0.2, 0.1, 0.05)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        """Reduce the contrast of one frame."""
        source = np.require(frame, requirements=("C", "W"))
        sums = np.zeros(3, np.int64)
        _channel_sums(source.reshape(source.shape[0], -1), sums)
        pixels = source.shape[0] * source.shape[1]
        means = np.full(3, sums.sum() / (3 * pixels)) if self.variant == "paper" else sums / pixels
        levels = (np.arange(256.0)[None, :] - means[:, None]) * state + means[:, None]
        out = np.empty_like(source)
        _look_up_channels(source.reshape(-1), to_bytes(levels, self.variant == "reference"), out.reshape(-1))
        return out


@njit(cache=True, nogil=True)
def _channel_sums(source: Any, sums: Any) -> None:
    """Add the sum of each channel of uint8 (H, 3 W) rows to `sums`, in lanes of 48 samples so that the loop
    vectorises.
    """
    lanes = np.zeros(192, np.uint32)
    for y in range(source.shape[0]):
        s = source[y]
        lanes[:] = 0
        whole = s.size - s.size % 192
        for start in range(0, whole, 192):
            block = s[start : start + 192]
            for i in range(192):
                lanes[i] += block[i]
        for i in range(whole, s.size):
            lanes[i - whole] += s[i]
        for i in range(192):
            sums[i % 3] += lanes[i]


@njit(cache=True, nogil=True)
def _look_up_channels(source: Any, table: Any, out: Any) -> None:
    red, green, blue = table[0], table[1], table[2]
    for i in range(source.size // 3):
        out[3 * i] = red[source[3 * i]]
        out[3 * i + 1] = green[source[3 * i + 1]]
        out[3 * i + 2] = blue[source[3 * i + 2]]
