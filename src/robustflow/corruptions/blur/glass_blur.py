"""Apply glass blur: blur, shuffle pixels within their neighbourhood, and blur again."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.rng import Rng, hash64
from ...core.types import Frame
from ..base import Corruption
from ..kernels.filters import FLOOR, gaussian_frame

SourceIndex = npt.NDArray[np.int32]
"""Flat source index of each pixel, int32 (H, W)."""


class Glass(NamedTuple):
    sigma: float  # standard deviation of both blurs, in pixels
    reach: int  # maximum distance alpha between swapped pixels, in pixels
    iterations: int  # number of shuffle passes beta


class GlassBlur(Corruption):
    """Applies a Gaussian blur, a local shuffle shared by both frames, and a second Gaussian blur (paper, appendix,
    blur).

    The severity parameters are (sigma, neighbourhood alpha, iterations beta). The shuffle proceeds from the bottom
    right to the top left and pairs each pixel with a random partner, whose offset is between -alpha and alpha - 1 in
    both directions. According to the paper, the two pixels are swapped. In the reference code, however, array views
    turn the swap into a copy: the pixel is set to its partner's value, and the partner is unchanged. Some values
    therefore disappear, and the content drifts by up to 2 px, equally in both frames. This is the default because it
    is part of the published results; `variant="paper"` swaps the pixels. The first blur truncates its result, as in
    the reference code.
    """

    name = "glass_blur"
    family = "blur"
    level = Glass
    paper_severities = ((0.7, 1, 2), (0.9, 2, 1), (1.0, 2, 3), (1.1, 3, 2), (1.5, 4, 2))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, SourceIndex]:
        glass: Glass = self.parameter(severity)
        return float(glass.sigma), draw_shuffle(rng, shape, glass.reach, glass.iterations, swap=self.variant == "paper")

    def apply(self, frame: Frame, state: tuple[float, SourceIndex], index: int) -> Frame:
        sigma, source = state
        blurred = gaussian_frame(frame, sigma, FLOOR)
        shuffled = np.empty_like(blurred)
        _gather(blurred.reshape(-1, 3), source.reshape(-1), shuffled.reshape(-1, 3))
        return gaussian_frame(shuffled, sigma)


def draw_shuffle(rng: Rng, shape: tuple[int, int], reach: int, iterations: int, swap: bool) -> SourceIndex:
    """Shuffle the pixel indices of an image of `shape` (H, W)."""
    height, width = shape
    source = np.arange(height * width, dtype=np.int32)
    steps = np.arange(-reach, reach)
    offsets = (steps[:, None] * width + steps[None, :]).ravel().astype(np.int64)
    for iteration in range(iterations):
        key = np.uint64(rng.spawn("shuffle", iteration).key)
        _shuffle(key, source, height, width, reach, offsets, swap)
    return source.reshape(shape)


@njit(cache=True, nogil=True)
def _shuffle(key: Any, source: Any, height: int, width: int, reach: int, offsets: Any, swap: bool) -> None:
    """Run one shuffle pass; 16 bits of a hash select one of at most 64 offsets, with a bias below 1e-3."""
    count = np.uint64(offsets.size)
    bits = np.uint64(0)
    drawn = 0
    for y in range(height - reach, reach, -1):
        for x in range(width - reach, reach, -1):
            if drawn % 4 == 0:
                bits = hash64(key, np.uint64(drawn // 4))
            drawn += 1
            here = y * width + x
            there = here + offsets[((bits & np.uint64(0xFFFF)) * count) >> np.uint64(16)]
            bits >>= np.uint64(16)
            value = source[np.uint64(here)]
            source[np.uint64(here)] = source[np.uint64(there)]
            if swap:
                source[np.uint64(there)] = value


@njit(cache=True, nogil=True)
def _gather(pixels: Any, source: Any, out: Any) -> None:
    for i in range(source.size):
        at = np.uint64(source[i])
        out[i, 0] = pixels[at, 0]
        out[i, 1] = pixels[at, 1]
        out[i, 2] = pixels[at, 2]
