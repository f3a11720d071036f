"""A random camera after Brooks et al. (CVPR 2019), and its exposure with photon noise, read noise and A/D conversion.

"Unprocessing Images for Learned Raw Denoising" converts an sRGB image back to sensor data: inverse tone curve
(smoothstep), inverse gamma (2.2), the camera's colour matrix, inverse white balance and brightness. Matrices, gains and
curves are those of the paper, with three changes, so that developing the RAW image reproduces the original image:

* a camera's response to a primary is never negative; the one negative entry of the fitted matrices is set to 0;
* near white, where the paper's gains fade to 1 depending on the grey value of the pixel, each channel fades separately,
  so that the step is invertible;
* the brightness is limited to the range 0.6 to 1, so that green never saturates the sensor.

The number of electrons follows a Poisson distribution whose mean is proportional to the light. Read-out adds Gaussian
noise, and the converter rounds to 14 bits and clips to the range between the black and white levels. The noise is
heteroscedastic: its variance is `shot` times the light plus `read` squared, in units of the white level, as in Foi et
al. (IEEE TIP 2008).
"""

from __future__ import annotations

from decimal import Decimal
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.rng import Rng, fill_bits
from ..kernels.alias import alias_table, counts_from_cdf, height_bits, poisson_cdf
from ..kernels.fields import UNIT, quantiles

Numbers = npt.NDArray[np.float64]

_CAMERAS = (
    ((1.0234, -0.2969, -0.2266), (-0.5625, 1.6328, -0.0469), (-0.0703, 0.2188, 0.6406)),
    ((0.4913, -0.0541, -0.0202), (-0.613, 1.3513, 0.2906), (-0.1564, 0.2151, 0.7183)),
    ((0.838, -0.263, -0.0639), (-0.2887, 1.0725, 0.2496), (-0.0627, 0.1427, 0.5438)),
    ((0.6596, -0.2079, -0.0562), (-0.4782, 1.3016, 0.1933), (-0.097, 0.1581, 0.5181)),
)
"""XYZ-to-camera matrices of the four cameras used for the Darmstadt Noise Dataset."""
_SRGB_TO_XYZ = ((0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750), (0.0193339, 0.1191920, 0.9503041))
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


Light = npt.NDArray[np.float32]
Raw = npt.NDArray[np.uint16]

BLACK, WHITE = 2048, (1 << 14) - 1
"""Output of the 14-bit converter for no light and for a saturated pixel."""
_LARGEST_ISO, _LARGEST_SHOT = 12800, 0.012
_SLOPE, _OFFSET = Decimal("2.18"), Decimal("1.20")
_WHOLE_BITS, _REST_BITS, _PARTS = 7, 3, 256
_BLOCK = 256
EXACT = 64
"""Mean number of electrons below which the Poisson distribution is sampled exactly."""


class Sensor(NamedTuple):
    shot: float
    read: float


NOISELESS = Sensor(0.0, 0.0)


@cache
def sensor_at(iso: int) -> Sensor:
    """Return the noise parameters for an ISO number, as fitted by Brooks et al. to the Darmstadt Noise Dataset."""
    shot = Decimal(repr(_LARGEST_SHOT)) * iso / _LARGEST_ISO
    return Sensor(float(shot), round(float(((_SLOPE * shot.ln() + _OFFSET) / 2).exp()), 12))


def exposed(light: Light, sensor: Sensor, key: np.uint64) -> Raw:
    """Compute a noisy RAW image."""
    out = np.empty(light.shape, np.uint16)
    scale = WHITE - BLACK
    factors = np.array([1.0 / sensor.shot, scale * sensor.shot, scale * sensor.read * UNIT], np.float32)
    tables = *_poisson_tables(), quantiles()
    _expose(np.ascontiguousarray(light).reshape(-1), *factors, *tables, key, out.reshape(-1))
    return out


def exposed_without_noise(light: Light) -> Raw:
    """Return the RAW image of a sensor without noise: the arguments and the result are those of `exposed`."""
    return np.rint(BLACK + light * np.float32(WHITE - BLACK)).astype(np.uint16)


@cache
def _poisson_tables() -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """Return concatenated alias tables for Poisson distributions."""
    whole = [_poisson_table(Decimal(mean), _WHOLE_BITS) for mean in range(EXACT)]
    rest = [_poisson_table((part + Decimal("0.5")) / _PARTS, _REST_BITS) for part in range(_PARTS)]
    return np.concatenate(whole), np.concatenate(rest)


def _poisson_table(mean: Decimal, bits: int) -> npt.NDArray[np.uint32]:
    return alias_table(counts_from_cdf(poisson_cdf(mean, 1 << bits), 1 << (bits + height_bits(bits))), bits, bits)


@njit(cache=True, nogil=True)
def _expose(
    light: Any, electrons: Any, level: Any, read: Any, whole: Any, rest: Any, normal: Any, key: Any, out: Any
) -> None:
    """Draw the electrons of each pixel of a row: below a mean of `EXACT`, Poisson numbers of its whole and its
    fractional part are added; above, a normal number is corrected for skewness."""
    words = np.empty(_BLOCK, np.uint64)
    counts, read_out = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    photons, columns, rest_columns = (
        np.empty(_BLOCK, np.float32),
        np.empty(_BLOCK, np.uint32),
        np.empty(_BLOCK, np.uint32),
    )
    entries, rest_entries = np.empty(_BLOCK, np.uint32), np.empty(_BLOCK, np.uint32)
    exact, below_exact = np.float32(EXACT), np.float32(EXACT * (1 - 2.0**-24))
    for start in range(0, light.size, _BLOCK):
        fill_bits(key, np.uint64(start), words)
        means, o = light[start : start + _BLOCK], out[start : start + _BLOCK]
        size, few = means.size, 0
        for i in range(size):
            few += means[i] * electrons < exact
        for i in range(size):
            read_out[i] = normal[words[i] >> np.uint64(48)]
        if few < size:
            for i in range(size):
                photons[i] = normal[words[i] & np.uint64(0xFFFF)]
            for i in range(size):
                mean, z = means[i] * electrons, photons[i] * np.float32(UNIT)
                skewness = (z * z - np.float32(1.0)) * np.float32(1.0 / 6.0)
                photons[i] = np.rint(mean + np.sqrt(mean) * z + skewness)
        if few:
            for i in range(size):
                mean = min(means[i] * electrons, below_exact)
                floor = np.int32(mean)
                part = np.int32((mean - np.float32(floor)) * np.float32(_PARTS))
                word = words[i]
                columns[i] = (np.uint32(floor) << np.uint32(7)) | (np.uint32(word) >> np.uint32(25))
                rest_columns[i] = (np.uint32(part) << np.uint32(3)) | (np.uint32(word >> np.uint64(45)) & np.uint32(7))
            for i in range(size):
                entries[i], rest_entries[i] = whole[columns[i]], rest[rest_columns[i]]
            for i in range(size):
                low, high, e, r = np.uint32(words[i]), np.uint32(words[i] >> np.uint64(32)), entries[i], rest_entries[i]
                below = (e >> np.uint32(14)) > ((low >> np.uint32(7)) & np.uint32(0x3FFFF))
                n = np.int32((e if below else e >> np.uint32(7)) & np.uint32(127))
                below = (r >> np.uint32(19)) > (high & np.uint32(0x1FFF))
                n += np.int32((r if below else r >> np.uint32(3)) & np.uint32(7))
                counts[i] = np.float32(n) if means[i] * electrons < exact else photons[i]
        else:
            for i in range(size):  # assigning the array would take three seconds longer to compile
                counts[i] = photons[i]
        for i in range(size):
            value = np.rint(np.float32(BLACK) + level * counts[i] + read * read_out[i])
            o[i] = np.uint16(np.int32(min(max(value, np.float32(0.0)), np.float32(WHITE))))
