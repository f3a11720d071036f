"""Random camera model after Brooks et al. (CVPR 2019): tone curve, colour matrix and white balance.

"Unprocessing Images for Learned Raw Denoising" converts an sRGB image back to sensor data: inverse tone curve
(smoothstep), inverse gamma (2.2), the camera's colour matrix, inverse white balance and brightness. Matrices, gains and
curves are those of the paper, with three changes, so that developing the RAW image reproduces the original image:

* a camera's response to a primary is never negative; the one negative entry of the fitted matrices is set to 0;
* near white, where the paper's gains fade to 1 depending on the grey value of the pixel, each channel fades separately,
  so that the step is invertible;
* the brightness is limited to the range 0.6 to 1, so that green never saturates the sensor.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.rng import Rng

Numbers = npt.NDArray[np.float64]

_CAMERAS = (
    ((1.0234, -0.2969, -0.2266), (-0.5625, 1.6328, -0.0469), (-0.0703, 0.2188, 0.6406)),
    ((0.4913, -0.0541, -0.0202), (-0.613, 1.3513, 0.2906), (-0.1564, 0.2151, 0.7183)),
    ((0.838, -0.263, -0.0639), (-0.2887, 1.0725, 0.2496), (-0.0627, 0.1427, 0.5438)),
    ((0.6596, -0.2079, -0.0562), (-0.4782, 1.3016, 0.1933), (-0.097, 0.1581, 0.5181)),
)
"""XYZ-to-camera matrices of the four cameras used for the Darmstadt Noise Dataset."""
_SRGB_TO_XYZ = (
    (0.4124564, 0.3575761, 0.1804375),
    (0.2126729, 0.7151522, 0.0721750),
    (0.0193339, 0.1191920, 0.9503041),
)
_RED, _BLUE = (1.9, 2.4), (1.5, 1.9)
_BRIGHTNESS, _BRIGHTNESS_SPREAD, _BRIGHTNESS_LIMITS = 0.8, 0.1, (0.6, 1.0)
LEVELS = 1 << 14
"""Size of the table that maps linear light to bytes; there are at least ten entries per byte value."""


class CameraColours(NamedTuple):
    """Camera parameters shared by both frames of a pair."""

    from_srgb: Numbers
    to_srgb: Numbers
    gains: Numbers


def draw_camera(rng: Rng) -> CameraColours:
    """Sample a camera: a random weighted mean of four cameras, with random white balance and brightness."""
    weights = [rng.uniform() + 1e-8 for _ in _CAMERAS]
    mean = np.zeros((3, 3))
    for weight, camera in zip(weights, _CAMERAS, strict=True):
        mean += weight / sum(weights) * np.array(camera)
    product = np.array([[sum(row[k] * _SRGB_TO_XYZ[k][j] for k in range(3)) for j in range(3)] for row in mean])
    response = np.maximum(product / _row_sums(product), 0.0)
    response /= _row_sums(response)
    brightness = float(np.clip(_BRIGHTNESS + _BRIGHTNESS_SPREAD * rng.normals(1)[0], *_BRIGHTNESS_LIMITS))
    red, blue = rng.uniform(*_RED), rng.uniform(*_BLUE)
    return CameraColours(response, _inverse(response), np.array([brightness / red, brightness, brightness / blue]))


def _row_sums(matrix: Numbers) -> Numbers:
    return matrix[:, :1] + matrix[:, 1:2] + matrix[:, 2:]


def _inverse(m: Numbers) -> Numbers:
    """Invert a matrix using cofactors, because the results of linear algebra libraries differ between machines."""
    next_row, last_row = np.roll(m, -1, axis=0), np.roll(m, 1, axis=0)
    cofactors = np.roll(next_row, -1, axis=1) * np.roll(last_row, 1, axis=1)
    cofactors = cofactors - np.roll(next_row, 1, axis=1) * np.roll(last_row, -1, axis=1)
    determinant = m[0, 0] * cofactors[0, 0] + m[0, 1] * cofactors[0, 1] + m[0, 2] * cofactors[0, 2]
    return np.ascontiguousarray(cofactors.T / determinant)


@cache
def linear_of_bytes() -> npt.NDArray[np.float32]:
    """Return the linear light of each byte value, float32 (256,): inverse tone curve, then inverse gamma."""
    return _linear(np.arange(256) / 255.0).astype(np.float32)


@cache
def bytes_of_linear() -> npt.NDArray[np.uint8]:
    """Return the byte value for each of `LEVELS` equal steps of linear light: gamma, then tone curve."""
    edges = _linear((np.arange(255) + 0.5) / 255.0)
    return np.searchsorted(edges, (np.arange(LEVELS) + 0.5) / LEVELS).astype(np.uint8)


def _linear(shown: npt.NDArray[np.floating[Any]]) -> npt.NDArray[Any]:
    """Solve shown = 3 v^2 - 2 v^3 with v = x^(1/2.2) for the linear light x."""
    low, high = np.zeros_like(shown), np.ones_like(shown)
    for _ in range(60):
        r = 0.5 * (low + high)
        r2 = r * r
        v = r2 * r2 * r
        below = v * v * (3.0 - 2.0 * v) < shown
        low, high = np.where(below, r, low), np.where(below, high, r)
    r2 = high * high
    r4 = r2 * r2
    return r4 * r4 * r2 * high
