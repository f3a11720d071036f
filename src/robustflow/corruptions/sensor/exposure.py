"""Expose a RAW image: photon noise, read noise and A/D conversion, with the noise level determined by the ISO number.

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
from ...core.rng import fill_bits
from ..kernels.alias import alias_table, counts_from_cdf, height_bits, poisson_cdf
from ..kernels.fields import UNIT, quantiles

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
    """Noise parameters of a sensor."""

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
    _expose(
        np.ascontiguousarray(light).reshape(-1),
        np.float32(1.0 / sensor.shot),
        np.float32(scale * sensor.shot),
        np.float32(scale * sensor.read * UNIT),
        *_poisson_tables(),
        quantiles(),
        key,
        out.reshape(-1),
    )
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
    """Expose the pixels."""
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
