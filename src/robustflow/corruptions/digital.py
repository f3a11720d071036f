"""JPEG compression, pixelation, contrast and saturation (paper, appendix "Digital corruptions").

All four treat each frame alone and draw nothing.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit

from ..errors import RobustFlowError
from ..random.rng import Rng
from ..sample import Frame
from .base import Corruption
from .kernels.box_resize import pixelated
from .kernels.rounding import to_bytes


class _Digital(Corruption):
    family = "digital"

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        return self.parameter(severity)


class JpegCompression(_Digital):
    """Through a baseline JPEG file with 4:2:0 chroma; `severities` are its quality (paper, "JPEG compression")."""

    name = "jpeg_compression"
    paper_severities = (25, 18, 15, 10, 7)

    def apply(self, frame: Frame, state: int, index: int) -> Frame:
        bgr = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, int(state)])
        if not done:
            raise RobustFlowError(f"OpenCV cannot encode a JPEG of {frame.shape[1]}x{frame.shape[0]} pixels")
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB, dst=decoded)


class Pixelate(_Digital):
    """Shrunk by a box filter to a factor of the size, grown back; `severities` are the factor (paper, "Pixelation")."""

    name = "pixelate"
    paper_severities = (0.6, 0.5, 0.4, 0.3, 0.25)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        return pixelated(frame, state)


class Contrast(_Digital):
    """(I - mean) c + mean; `severities` are c (paper, "Contrast").

    The mean is per channel, as in the code; `variant="paper"` takes one mean over the frame, as its formula reads.
    `variant="reference"` cuts fractions of a grey level off, as the code does.
    """

    name = "contrast"
    paper_severities = (0.4, 0.3, 0.2, 0.1, 0.05)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        sums = np.zeros(3, np.int64)
        _channel_sums(source.reshape(source.shape[0], -1), sums)
        pixels = source.shape[0] * source.shape[1]
        means = np.full(3, sums.sum() / (3 * pixels)) if self.variant == "paper" else sums / pixels
        levels = (np.arange(256.0)[None, :] - means[:, None]) * state + means[:, None]
        out = np.empty_like(source)
        _look_up_channels(source.reshape(-1), to_bytes(levels, self.variant == "reference"), out.reshape(-1))
        return out


class Saturate(_Digital):
    """S' = S alpha + beta in HSV; `severities` are (alpha, beta) (paper, "Saturate").

    The reference code has the first two severities the other way round and cuts fractions of a grey level off
    (`variant="reference"`). Hue and V stay, so
    with V = max(R, G, B) and m = min(R, G, B) a channel c becomes V - V S' (V - c) / (V - m). Grey has hue 0: where
    beta > 0 it turns red.
    """

    name = "saturate"
    paper_severities = ((0.1, 0.0), (0.3, 0.0), (2.0, 0.0), (5.0, 0.1), (20.0, 0.2))

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        first, second, *rest = self.paper_severities
        return (second, first, *rest) if variant == "reference" else self.paper_severities

    def apply(self, frame: Frame, state: tuple[float, float], index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        alpha, beta = (np.float32(10.0 * value) for value in state)
        _saturate(source.reshape(-1), alpha, beta, self.variant == "reference", out.reshape(-1))
        return out


@njit(cache=True, nogil=True)
def _channel_sums(source: Any, sums: Any) -> None:
    """Add the sum of each channel of uint8 (H, 3 W) rows to `sums`, in lanes of 48 samples so that it vectorises."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def _saturate(source: Any, alpha: Any, beta: Any, floor: bool, out: Any) -> None:
    """`alpha` and `beta` are ten times the paper's, float32, so that all but the quotient is exact for its numbers."""
    ten, one, zero = np.float32(10), np.float32(1), np.float32(0)
    # Adding and subtracting 2**23 rounds to an integer, half to even; the conversion to an integer cuts off.
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
