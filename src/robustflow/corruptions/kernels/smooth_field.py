"""Generate uniform noise blurred with a wide Gaussian, in time independent of the Gaussian's width.

A field blurred with standard deviation s varies slowly, so it is computed only at every (s / 2.5)-th row and column,
with cubic interpolation in between; the error is about 0.5 % of the field's standard deviation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...compiled import inner, njit
from ...random.rng import Rng, hash64
from .borders import mirrored_with_edge

_SAMPLES_PER_SIGMA = 2.5
_TRUNCATE = 3.0
_FULL = 32767
"""Sum of the integer weights along a row; its product with 16-bit noise stays below 2**30."""


class SmoothField(NamedTuple):
    """A smooth field on a coarse grid."""

    samples: npt.NDArray[np.float32]
    """Samples of the field, float32; sample (i, j) is at row (i - 1) * steps[0], column (j - 1) * steps[1]."""
    steps: tuple[int, int]
    """Spacing of the samples in rows and columns, in pixels."""


def smooth_field(rng: Rng, shape: tuple[int, int], sigmas: tuple[float, float], amplitude: float) -> SmoothField:
    """Generate uniform white noise in +-amplitude, blurred with a Gaussian cut off at three standard deviations."""
    height, width = shape
    steps = max(1, int(sigmas[0] / _SAMPLES_PER_SIGMA)), max(1, int(sigmas[1] / _SAMPLES_PER_SIGMA))
    along = np.rint(_kernel(sigmas[1]) * _FULL)
    along[len(along) // 2] += _FULL - along.sum()
    down = (_kernel(sigmas[0]) * (amplitude / _FULL / 32768)).astype(np.float32)
    columns = (width - 1) // steps[1] + 4
    blurred = np.empty((height, columns), np.float32)
    _blur_along(np.uint64(rng.key), width, steps[1], along.astype(np.int16), blurred)
    samples = np.empty(((height - 1) // steps[0] + 4, columns), np.float32)
    _blur_down(blurred, steps[0], down, samples)
    return SmoothField(samples, steps)


def _kernel(sigma: float) -> npt.NDArray[np.float64]:
    radius = int(_TRUNCATE * sigma + 0.5)
    if radius == 0:
        return np.ones(1)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return kernel / kernel.sum()


@inner
def _dot(a: Any, b: Any) -> Any:
    total = np.int32(0)
    for i in range(a.size):
        total = np.int32(total + np.int32(np.int32(a[i]) * np.int32(b[i])))
    return total


@njit(cache=True, nogil=True)
def _blur_along(key: Any, width: int, step: int, weights: Any, out: Any) -> None:
    radius = weights.size // 2
    before = step + radius
    words = (width + 3) // 4
    noise = np.empty(4 * words, np.int16)
    padded = np.empty((out.shape[1] - 1) * step + 2 * radius + 1, np.int16)
    for y in range(out.shape[0]):
        for i in range(words):
            bits = hash64(key, np.uint64(y) * np.uint64(words) + np.uint64(i))
            four = noise[4 * i : 4 * i + 4]
            four[0] = np.int16(bits & np.uint64(0xFFFF))
            four[1] = np.int16((bits >> np.uint64(16)) & np.uint64(0xFFFF))
            four[2] = np.int16((bits >> np.uint64(32)) & np.uint64(0xFFFF))
            four[3] = np.int16(bits >> np.uint64(48))
        for i in range(width):  # numba compiles a loop seconds faster than an assignment of slices
            padded[before + i] = noise[i]
        for i in range(before):
            padded[i] = noise[mirrored_with_edge(i - before, width)]
        for i in range(before + width, padded.size):
            padded[i] = noise[mirrored_with_edge(i - before, width)]
        row = out[y]
        for j in range(row.size):
            row[j] = np.float32(_dot(padded[j * step : j * step + weights.size], weights))


@njit(cache=True, nogil=True)
def _blur_down(rows: Any, step: int, weights: Any, out: Any) -> None:
    radius, height = weights.size // 2, rows.shape[0]
    for i in range(out.shape[0]):
        target = out[i]
        target[:] = 0
        for k in range(weights.size):
            row, w = rows[mirrored_with_edge((i - 1) * step + k - radius, height)], weights[k]
            for j in range(target.size):
                target[j] += w * row[j]


@inner
def _cubic(t: Any) -> Any:
    """Return the weights of the samples at -1, 0, 1 and 2 for cubic interpolation at t in [0, 1)."""
    one, two = np.float32(1), np.float32(2)
    a, b, c = t + one, t - one, t - two
    sixth, half = np.float32(1 / 6), np.float32(0.5)
    return -t * b * c * sixth, a * b * c * half, -a * t * c * half, a * t * b * sixth


@njit(cache=True, nogil=True)
def field_row(samples: Any, steps: Any, y: int, out: Any) -> None:
    """Interpolate row `y` of the field at every column and write it to `out`, float32 (W,)."""
    row = np.empty(samples.shape[1], np.float32)
    i = y // steps[0]
    w0, w1, w2, w3 = _cubic(np.float32(y - i * steps[0]) / np.float32(steps[0]))
    a, b, c, d = samples[i], samples[i + 1], samples[i + 2], samples[i + 3]
    for j in range(row.size):
        row[j] = (w0 * a[j] + w1 * b[j]) + (w2 * c[j] + w3 * d[j])
    step = steps[1]
    for phase in range(step):
        w0, w1, w2, w3 = _cubic(np.float32(phase) / np.float32(step))
        for j in range((out.size - phase + step - 1) // step):
            out[j * step + phase] = (w0 * row[j] + w1 * row[j + 1]) + (w2 * row[j + 2] + w3 * row[j + 3])
