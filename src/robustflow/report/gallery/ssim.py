"""The structural similarity of two images.

SSIM: Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error Visibility to Structural Similarity",
IEEE Transactions on Image Processing 13(4), 2004, on luma with an 11 x 11 Gaussian window (sigma 1.5), K1 = 0.01,
K2 = 0.03 and borders mirrored about the edge pixel, averaged over all pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ...core.errors import DataError
from ...core.types import Frame

_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


class Ssim:
    """Computes the similarity to a reference image, whose moments are computed once."""

    def __init__(self, reference: Frame) -> None:
        self._luma = _luma(reference)
        self._mean, self._square = _window(self._luma), _window(self._luma**2)

    def __call__(self, image: Frame) -> float:
        """Return the mean SSIM between `image`, RGB uint8 (H, W, 3), and the reference."""
        luma = _luma(image)
        if luma.shape != self._luma.shape:
            (height, width), (wanted_height, wanted_width) = luma.shape, self._luma.shape
            raise DataError(
                f"{height}x{width}", f"the size of an image whose reference is {wanted_height}x{wanted_width}"
            )
        mean = _window(luma)
        product, squares = self._mean * mean, self._mean**2 + mean**2
        spread = self._square + _window(luma**2) - squares
        shared = _window(self._luma * luma) - product
        return float(((2 * product + _C1) * (2 * shared + _C2) / ((squares + _C1) * (spread + _C2))).mean())


def _luma(image: Frame) -> npt.NDArray[np.float64]:
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float64)


def _window(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(values, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT_101))
