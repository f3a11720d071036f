"""Change the contrast or the saturation."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from ...core.compiled import njit
from ...core.types import Frame
from ..base import Corruption
from ..kernels.filters import to_bytes


class Contrast(Corruption):
    """Reduces the contrast: out = (I - mean) c + mean; the severity parameter is c (paper, "Contrast").

    The mean is computed per channel, as in the reference code; `variant="paper"` uses one mean for the entire frame, as
    in the paper's formula. `variant="reference"` truncates grey levels, as the reference code does.
    """

    name = "contrast"
    family = "digital"
    paper_severities = (0.4, 0.3, 0.2, 0.1, 0.05)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        source = np.ascontiguousarray(frame)
        sums = np.array(cv2.sumElems(source)[:3])
        pixels = source.shape[0] * source.shape[1]
        means = np.full(3, sums.sum() / (3 * pixels)) if self.variant == "paper" else sums / pixels
        levels = (np.arange(256.0)[None, :] - means[:, None]) * state + means[:, None]
        return np.asarray(cv2.LUT(source, to_bytes(levels, self.variant == "reference").T[None]))


class Saturation(NamedTuple):
    """Parameters for one severity: S' = S alpha + beta."""

    alpha: float
    beta: float


class Saturate(Corruption):
    """Changes the saturation in HSV: S' = S alpha + beta; the severity parameters are (alpha, beta) (paper,
    "Saturate").

    The reference code swaps the first two severities and truncates grey levels (`variant="reference"`). Hue and V are
    unchanged, so a channel c becomes V - V S' (V - c) / (V - m), where V = max(R, G, B) and m = min(R, G, B). Grey has
    a hue of 0, so it turns red if beta > 0.
    """

    name = "saturate"
    family = "digital"
    level = Saturation
    paper_severities = ((0.1, 0.0), (0.3, 0.0), (2.0, 0.0), (5.0, 0.1), (20.0, 0.2))

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        first, second, *rest = self.paper_severities
        return (second, first, *rest) if variant == "reference" else self.paper_severities

    def apply(self, frame: Frame, state: Saturation, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        alpha, beta = (np.float32(10.0 * value) for value in state)
        _saturate(source.reshape(-1), alpha, beta, self.variant == "reference", out.reshape(-1))
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def _saturate(source: Any, alpha: Any, beta: Any, floor: bool, out: Any) -> None:
    """Change the saturation; `alpha` and `beta` are float32 and ten times the paper's values."""
    ten, one, zero = np.float32(10), np.float32(1), np.float32(0)
    # Adding and subtracting 2**23 rounds to an integer, half to even; the conversion to an integer truncates.
    half_even = zero if floor else np.float32(2**23)
    for i in range(source.size // 3):
        r, g, b = np.float32(source[3 * i]), np.float32(source[3 * i + 1]), np.float32(source[3 * i + 2])
        value = max(r, max(g, b))
        delta = value - min(r, min(g, b))
        grey = one if delta == zero else zero
        chroma = min(ten * value, alpha * delta + beta * value)  # 10 V S'
        scale = ten * (delta + grey)
        r = value - chroma * (value - r) / scale
        g = value - chroma * (value - g + grey) / scale
        b = value - chroma * (value - b + grey) / scale
        out[3 * i] = np.uint8(np.int32(r + half_even - half_even))
        out[3 * i + 1] = np.uint8(np.int32(g + half_even - half_even))
        out[3 * i + 2] = np.uint8(np.int32(b + half_even - half_even))
