"""Random fields: blurred uniform noise, Gaussian noise, and a plasma fractal used as a fog map.

A field blurred with standard deviation s varies slowly, so it is computed only at every (s / 2.5)-th row and column,
with cubic interpolation in between; the error is about 0.5 % of the field's standard deviation.

The plasma fractal (diamond-square) is a torus with 2**k points per side. It starts as a single point of value 0 and is
doubled k times; each new point is the mean of its four neighbours plus uniform noise with an amplitude of
10000 / decay**(2 * level). The noise is a hash of the point's position, so any part can be refined separately: the full
torus is computed up to 512 x 512, and beyond that only the visible corner.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.rng import Rng, fill_bits, hash64, normals_from_bits
from .filters import mirrored_with_edge

_SAMPLES_PER_SIGMA = 2.5
_TRUNCATE = 3.0
_FULL = 32767
"""Sum of the integer weights along a row; its product with 16-bit noise stays below 2**30."""


class SmoothField(NamedTuple):
    samples: npt.NDArray[np.float32]
    """Samples of the field, float32; sample (i, j) is at row (i - 1) * steps[0], column (j - 1) * steps[1]."""
    steps: tuple[int, int]  # spacing of the samples in rows and columns, in pixels


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
    """Sum products of int16 in int32, a form that compiles to the processor's multiply-and-add."""
    total = np.int32(0)
    for i in range(a.size):
        total = np.int32(total + np.int32(np.int32(a[i]) * np.int32(b[i])))
    return total


@njit(cache=True, nogil=True)
def _blur_along(key: Any, width: int, step: int, weights: Any, out: Any) -> None:
    """Draw the noise of each row, four samples from a hash, and filter it at every `step`-th column of N."""
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
    """Filter columns of `rows` (H, N) at every `step`-th row; node 0 lies one step outside."""
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


UNIT = 2.0**-12
"""Quantisation step of a field; samples are rounded to multiples of 1/4096."""


def normal_field(rng: Rng, height: int, width: int) -> npt.NDArray[np.int16]:
    """Generate independent standard normal samples, int16 (height, width) in units of `UNIT`."""
    out = np.empty((height, width), np.int16)
    words = np.empty(256, np.uint64)  # fits in the L1 cache
    _fill(np.uint64(rng.spawn("normal").key), quantiles(), words, words.view(np.uint16), out.reshape(-1))
    return out


@cache
def quantiles() -> npt.NDArray[np.int16]:
    """Return the quantiles of the normal distribution for the probabilities (i + 1/2) / 65536, int16 in units of
    `UNIT`.
    """
    normals = normals_from_bits((np.arange(65536, dtype=np.uint64) << np.uint64(48)) | np.uint64(1 << 47))
    return np.rint(normals / UNIT).astype(np.int16)


@njit(cache=True, nogil=True)
def _fill(key: Any, table: Any, words: Any, lanes: Any, out: Any) -> None:
    """Look up each of the four 16-bit lanes of every hash value; `lanes` are the same memory as `words`."""
    for start in range(0, out.size, lanes.size):
        fill_bits(key, np.uint64(start // 4), words)
        part = out[start : start + lanes.size]
        for i in range(part.size):
            part[i] = table[lanes[i]]


_WHOLE = 512
_AMPLITUDE = 100.0


def plasma_corner(rng: Rng, height: int, width: int, decay: float) -> npt.NDArray[np.float32]:
    """Return the top left corner, float32 (height, width) in [0, 1], of the smallest plasma map that contains it."""
    size = 1 << (max(height, width, 2) - 1).bit_length()
    grid = np.zeros((1, 1), np.float32)
    level = 0
    while len(grid) < min(size, _WHOLE):
        grid = _doubled(np.pad(grid, 1, mode="wrap"), -1, len(grid), *_noise(rng, level, decay))
        level += 1
    low, high = grid.min(), grid.max()
    if len(grid) < size:
        rows, columns = _points_needed(height, size // len(grid)), _points_needed(width, size // len(grid))
        start = -2  # two extra points before the corner at every level: doubling consumes one and doubles the other
        corner = np.take(grid, range(start, start + rows), 0, mode="wrap")
        corner = np.take(corner, range(start, start + columns), 1, mode="wrap")
        points = len(grid)
        while points < size:
            corner = _doubled(corner, start, points, *_noise(rng, level, decay))
            points *= 2
            level += 1
        grid = corner[-start:, -start:]
    corner = grid[:height, :width]
    low, high = min(low, corner.min()), max(high, corner.max())
    return (corner - low) / (high - low)


def _noise(rng: Rng, level: int, decay: float) -> tuple[np.uint64, np.float32]:
    return np.uint64(rng.spawn("plasma", level).key), np.float32((_AMPLITUDE / decay**level) ** 2)


def _points_needed(length: int, factor: int) -> int:
    """Return the number of points needed to cover `length` points and the margin after upscaling by `factor`."""
    points = length + 2
    while factor > 1:
        points = -(-points // 2) + 2
        factor //= 2
    return points


@inner
def _uniform(bits: Any, amplitude: Any) -> Any:
    """Convert the lowest 16 bits to a uniformly distributed number in +-amplitude."""
    return amplitude * (np.float32(np.int32(bits & np.uint64(0xFFFF))) * np.float32(2.0**-15) - np.float32(1))


def _doubled(
    coarse: npt.NDArray[np.float32], start: int, points: int, key: np.uint64, amplitude: np.float32
) -> npt.NDArray[np.float32]:
    """Refine part of a torus with `points`**2 points, starting at row and column `start`."""
    rows, columns = coarse.shape
    fine = np.empty((2 * rows - 4, 2 * columns - 4), np.float32)
    centres, bits = np.empty((2, columns - 1), np.float32), np.empty(columns - 1, np.uint64)
    _double(coarse, start, points, key, amplitude, centres, bits, fine)
    return fine


@njit(cache=True, nogil=True)
def _double(coarse: Any, start: int, points: int, key: Any, amplitude: Any, centres: Any, bits: Any, fine: Any) -> None:
    """Double the resolution by one diamond and one square step; only two rows of `centres` (2, N) are kept."""
    rows, columns = coarse.shape
    quarter = np.float32(0.25)
    for i in range(rows - 1):
        here, below = coarse[i], coarse[i + 1]
        above, centre = centres[(i + 1) % 2], centres[i % 2]
        first = np.uint64((start + i) % points) * np.uint64(points)
        for j in range(columns - 1):
            bits[j] = hash64(key, first + np.uint64((start + j) % points))
        for j in range(columns - 1):
            corners = (here[j] + here[j + 1]) + (below[j] + below[j + 1])
            centre[j] = corners * quarter + _uniform(bits[j], amplitude)
        if i > 0:
            even, odd = fine[2 * i - 2], fine[2 * i - 1]
            for j in range(1, columns - 1):
                right = (here[j] + here[j + 1]) + (above[j] + centre[j])
                even[2 * j - 2] = here[j]
                even[2 * j - 1] = right * quarter + _uniform(bits[j] >> np.uint64(16), amplitude)
            for j in range(1, columns - 1):  # in one loop, this would take twice as long
                down = (here[j] + below[j]) + (centre[j - 1] + centre[j])
                odd[2 * j - 2] = down * quarter + _uniform(bits[j] >> np.uint64(32), amplitude)
                odd[2 * j - 1] = centre[j]
