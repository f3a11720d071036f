"""Compute the structural similarity of two images, with the same result on every machine.

Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error Visibility to Structural Similarity", IEEE
Transactions on Image Processing 13(4), 2004. SSIM is computed on luma with an 11 x 11 Gaussian window (sigma 1.5),
K1 = 0.01, K2 = 0.03 and borders mirrored about the edge pixel, and averaged over all pixels.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.errors import DataError
from ...core.types import Frame
from ..kernels.separable import mirrored

RADIUS = 5
SIGMA = 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


class Ssim:
    """Computes the similarity to a reference image, whose moments are computed once."""

    def __init__(self, reference: Frame) -> None:
        self._luma = _luma(reference)
        self._mean, self._square, _ = _moments(self._luma, self._luma)

    def __call__(self, image: Frame) -> float:
        """Return the mean SSIM between `image`, RGB uint8 (H, W, 3), and the reference."""
        luma = _luma(image)
        if luma.shape != self._luma.shape:
            raise DataError(
                f"images differ in size: {self._luma.shape[0]}x{self._luma.shape[1]} and "
                f"{luma.shape[0]}x{luma.shape[1]}; the sizes must match"
            )
        return float(_mean_ssim(self._mean, self._square, *_moments(luma, self._luma)))


def _luma(image: Frame) -> npt.NDArray[np.uint8]:
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)


@lru_cache(maxsize=1)
def _window() -> npt.NDArray[np.float64]:
    taps = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / SIGMA) ** 2)
    return taps / taps.sum()


def _moments(image: Any, other: Any) -> tuple[npt.NDArray[np.float64], ...]:
    """Compute the windowed means of image, image^2 and image * other, each float64 (H, W)."""
    mean, square, product = (np.empty(image.shape, np.float64) for _ in range(3))
    _filter_moments(image, other, _window(), mean, square, product)
    return mean, square, product


@inner
def _along(padded: Any, taps: Any, out: Any) -> None:
    """Mirror both ends of `padded`, whose interior is already filled, and write the filtered result to `out`."""
    width = out.size
    for j in range(RADIUS):
        padded[RADIUS - 1 - j] = padded[RADIUS + mirrored(-1 - j, width)]
        padded[RADIUS + width + j] = padded[RADIUS + mirrored(width + j, width)]
    out[:] = 0.0
    for k in range(taps.size):
        part = padded[k : k + width]
        for x in range(width):
            out[x] += taps[k] * part[x]


@njit(cache=True, nogil=True)
def _filter_moments(image: Any, other: Any, taps: Any, mean: Any, square: Any, product: Any) -> None:
    height, width = image.shape
    rows = np.empty((3, width + 2 * RADIUS))
    for y in range(height):
        first = rows[0][RADIUS : RADIUS + width]
        second = rows[1][RADIUS : RADIUS + width]
        mixed = rows[2][RADIUS : RADIUS + width]
        first[:], second[:], mixed[:] = 0.0, 0.0, 0.0
        for k in range(taps.size):
            a, b = image[mirrored(y + k - RADIUS, height)], other[mirrored(y + k - RADIUS, height)]
            for x in range(width):
                value, weighted = np.float64(a[x]), taps[k] * np.float64(a[x])
                first[x] += weighted
                second[x] += weighted * value
                mixed[x] += weighted * np.float64(b[x])
        _along(rows[0], taps, mean[y])
        _along(rows[1], taps, square[y])
        _along(rows[2], taps, product[y])


@njit(cache=True, nogil=True)
def _mean_ssim(mean_a: Any, square_a: Any, mean_b: Any, square_b: Any, product: Any) -> float:
    total = 0.0
    height, width = product.shape
    for y in range(height):
        for x in range(width):
            ma, mb = mean_a[y, x], mean_b[y, x]
            spread = (square_a[y, x] - ma * ma) + (square_b[y, x] - mb * mb)
            shared = product[y, x] - ma * mb
            total += ((2 * ma * mb + _C1) * (2 * shared + _C2)) / ((ma * ma + mb * mb + _C1) * (spread + _C2))
    return total / (height * width)
