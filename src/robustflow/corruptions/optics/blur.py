"""Blur an image with a spatially varying PSF, interpolated between columns of nodes with triangular windows.

Every sum of the compiled single-precision arithmetic has a fixed order: loops process a fixed number of neighbouring
values without summing across them, so the compiler can vectorise them without reordering additions. See docs/optics.md
for the error relative to exact kernels and the run time.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, intrinsic, njit
from ...core.types import Frame
from ..kernels.cache import BytesCache
from .psf_field import SIZE, Axis, PsfField, grid_of, kernels_at

BLOCK = 64
"""Number of image rows transformed together."""

CHUNK = 32
"""Number of rows convolved along y together."""

UNROLL = 4
"""Number of lags summed before they are added to the running sum; the total number of lags is a multiple of this."""

_LAG = 3 * CHUNK

LENGTHS = (24, 27, 32, 36, 48, 54, 64, 72, 81, 96, 108, 128)
"""Supported transform lengths, which are products of 2 and 3; the largest suffices for the widest window and kernel."""

_ZERO, _PLUS, _MINUS = np.float32(0.0), np.float32(1.0), np.float32(-1.0)
_SIN_60 = np.float32(math.sqrt(3.0) / 2.0)
_HALF = np.float32(0.5)
_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@intrinsic
def _fma(_: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c (all float32), rounded once."""

    def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return a(a, b, c), generate


def transform_length(least: int) -> int:
    """Return the smallest length in `LENGTHS` that is at least `least`.

    >>> transform_length(108), transform_length(73)
    (108, 81)
    """
    return next(length for length in LENGTHS if length >= least)


@lru_cache(maxsize=16)
def twiddles(length: int) -> npt.NDArray[np.float32]:
    """Return the real and imaginary parts of exp(-2 pi i k / length) for all k < `length`, float32 (length, 2)."""
    angles = [2.0 * math.pi * k / length for k in range(length)]
    return np.array([(math.cos(angle), -math.sin(angle)) for angle in angles], np.float32)


def transform(work: npt.NDArray[np.float32], roots: npt.NDArray[np.float32]) -> None:
    """Fourier-transform the third axis in place, using Stockham's algorithm with radices 4, 3 and 2."""
    blocks = work.reshape(-1, len(roots), 2 * BLOCK)
    _transform(blocks, np.empty(blocks.shape[1:], np.float32), roots)


@njit(**_OPTIONS)
def _transform(blocks: Any, spare: Any, roots: Any) -> None:
    for m in range(blocks.shape[0]):
        block = blocks[m]
        if _transform_block(block, spare, roots):
            for t in range(spare.shape[0]):
                source, target = spare[t], block[t]
                for i in range(2 * BLOCK):
                    target[i] = source[i]


@inner
def _transform_block(work: Any, spare: Any, roots: Any) -> Any:
    """Transform one block; return whether the result is in `spare`."""
    length, in_spare = roots.shape[0], False
    n, s, x, y = length, 1, work, spare
    while n > 1:
        radix = 4 if n % 4 == 0 else (3 if n % 3 == 0 else 2)
        m = n // radix
        for p in range(m):
            k = p * s
            w1r, w1i = roots[k, 0], roots[k, 1]
            w2r, w2i = roots[(2 * k) % length, 0], roots[(2 * k) % length, 1]
            w3r, w3i = roots[(3 * k) % length, 0], roots[(3 * k) % length, 1]
            for q in range(s):
                a, b = x[q + s * p], x[q + s * (p + m)]
                e, f = y[q + s * radix * p], y[q + s * (radix * p + 1)]
                if radix == 2:
                    for i in range(BLOCK):
                        j = i + BLOCK
                        ur, ui = a[i] - b[i], a[j] - b[j]
                        e[i], e[j] = a[i] + b[i], a[j] + b[j]
                        f[i], f[j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                    continue
                c, g = x[q + s * (p + 2 * m)], y[q + s * (radix * p + 2)]
                if radix == 3:
                    for i in range(BLOCK):
                        j = i + BLOCK
                        tr, ti = b[i] + c[i], b[j] + c[j]
                        dr, di = (b[i] - c[i]) * _SIN_60, (b[j] - c[j]) * _SIN_60
                        hr, hi = a[i] - _HALF * tr, a[j] - _HALF * ti
                        e[i], e[j] = a[i] + tr, a[j] + ti
                        ur, ui = hr + di, hi - dr
                        f[i], f[j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                        ur, ui = hr - di, hi + dr
                        g[i], g[j] = ur * w2r - ui * w2i, ur * w2i + ui * w2r
                    continue
                d, h = x[q + s * (p + 3 * m)], y[q + s * (radix * p + 3)]
                for i in range(BLOCK):
                    j = i + BLOCK
                    t0r, t0i = a[i] + c[i], a[j] + c[j]
                    t1r, t1i = a[i] - c[i], a[j] - c[j]
                    t2r, t2i = b[i] + d[i], b[j] + d[j]
                    t3r, t3i = b[i] - d[i], b[j] - d[j]
                    e[i], e[j] = t0r + t2r, t0i + t2i
                    ur, ui = t1r + t3i, t1i - t3r
                    f[i], f[j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                    ur, ui = t0r - t2r, t0i - t2i
                    g[i], g[j] = ur * w2r - ui * w2i, ur * w2i + ui * w2r
                    ur, ui = t1r - t3i, t1i + t3r
                    h[i], h[j] = ur * w3r - ui * w3i, ur * w3i + ui * w3r
        n, s, x, y, in_spare = m, s * radix, y, x, not in_spare
    return in_spare


@inner
def _blend(spectrum: Any, first: Any, weights: Any, blended: Any) -> None:
    """Interpolate the kernels u + iv of the nodes for each row of a chunk, and store u, u + v and v - u."""
    blended[:] = 0
    last = spectrum.shape[0] - 1
    for node in range(0, weights.size // CHUNK, 4):
        w = weights[node * CHUNK : (node + 4) * CHUNK]
        a, b = spectrum[min(first + node, last)], spectrum[min(first + node + 1, last)]
        c, d = spectrum[min(first + node + 2, last)], spectrum[min(first + node + 3, last)]
        for lag in range(spectrum.shape[1]):
            u0, u1, u2, u3 = a[lag, 0], b[lag, 0], c[lag, 0], d[lag, 0]
            v0, v1, v2, v3 = a[lag, 1], b[lag, 1], c[lag, 1], d[lag, 1]
            k = blended[lag * _LAG : (lag + 1) * _LAG]
            for p in range(CHUNK):
                w0, w1, w2, w3 = w[p], w[p + CHUNK], w[p + 2 * CHUNK], w[p + 3 * CHUNK]
                u = _fma(w3, u3, _fma(w2, u2, _fma(w1, u1, w0 * u0)))
                v = _fma(w3, v3, _fma(w2, v2, _fma(w1, v1, w0 * v0)))
                k[p] += u
                k[p + CHUNK] += u + v
                k[p + 2 * CHUNK] += v - u


@inner
def _convolve(blended: Any, lines: Any, begin: Any, sums: Any, out: Any) -> None:
    """Convolve two lines with interpolated kernels, by summing products over the lags."""
    sums[:] = 0
    for lag in range(0, blended.size // _LAG, UNROLL):
        for part in range(3):
            k = blended[lag * _LAG + part * CHUNK : (lag + UNROLL) * _LAG]
            x = lines[0, part, begin + lag : begin + lag + CHUNK + UNROLL]
            y = lines[1, part, begin + lag : begin + lag + CHUNK + UNROLL]
            total = sums[2 * part * CHUNK : 2 * (part + 1) * CHUNK]
            for p in range(CHUNK):
                k0, k1, k2, k3 = k[p], k[p + _LAG], k[p + 2 * _LAG], k[p + 3 * _LAG]
                first = _fma(k1, x[p + 1], _fma(k0, x[p], total[p]))
                second = _fma(k1, y[p + 1], _fma(k0, y[p], total[p + CHUNK]))
                total[p] = _fma(k3, x[p + 3], _fma(k2, x[p + 2], first))
                total[p + CHUNK] = _fma(k3, y[p + 3], _fma(k2, y[p + 2], second))
    for line in range(2):
        real, imaginary = out[line, 0], out[line, 1]
        for p in range(CHUNK):
            q = p + line * CHUNK
            real[p] = sums[q] - sums[q + 2 * CHUNK]
            imaginary[p] = sums[q] + sums[q + 4 * CHUNK]


@njit(**_OPTIONS)
def convolve_rows(spectra: Any, image: Any, shape: Any, firsts: Any, weights: Any, top: Any, out: Any) -> None:
    """Convolve an image along y; in the lower half, the kernel for each row is interpolated between the nearest
    nodes.
    """
    (rows, height), length, lags, count = shape, image.shape[2], spectra.shape[3], firsts.size * CHUNK
    blended, sums = np.empty(lags * _LAG, np.float32), np.empty(2 * _LAG, np.float32)
    lines = np.zeros((2, 2, 3, rows + lags + CHUNK), np.float32)  # (k, T - k) x (upright, flipped) x (x + y, y, x)
    convolved = np.empty((2, 2, 2, count), np.float32)  # (k, T - k) x (upright, flipped) x (real, imaginary)
    for channel in range(3):
        for k in range(length // 2 + 1):
            both = 2 if 0 < 2 * k < length else 1
            for other in range(both):
                t, sign = (length - k, _MINUS) if other else (k, _PLUS)
                for r in range(rows):
                    x = image[channel, r // BLOCK, t, 0, r % BLOCK]
                    y = sign * image[channel, r // BLOCK, t, 1, r % BLOCK]
                    for turned, place in ((0, r), (1, rows - 1 - r)):
                        line = lines[other, turned]
                        line[0, place], line[1, place], line[2, place] = x + y, y, x
            for chunk in range(firsts.size):
                place = chunk * CHUNK
                _blend(spectra[:, channel, k], firsts[chunk], weights[chunk], blended)
                for other in range(both):
                    to = convolved[other, :, :, place : place + CHUNK]
                    _convolve(blended, lines[other], top + place, sums, to)
            for other in range(both):
                t, sign = (length - k, _MINUS) if other else (k, _PLUS)
                upright, turned_ = convolved[other, 0], convolved[other, 1]
                for r in range(height):
                    x, y, up, down = _ZERO, _ZERO, r - top, height - 1 - r - top
                    if 0 <= up < count:
                        x, y = upright[0, up], upright[1, up]
                    if 0 <= down < count:
                        x, y = x + turned_[0, down], y + turned_[1, down]
                    out[channel, r // BLOCK, t, 0, r % BLOCK] = sign * y
                    out[channel, r // BLOCK, t, 1, r % BLOCK] = x


GREY = 128.0
"""Grey level subtracted from all pixels, because sums of smaller numbers have smaller rounding errors."""

_REACH = SIZE // 2


class Kernels(NamedTuple):
    spectra: npt.NDArray[np.float32]
    firsts: npt.NDArray[np.int64]
    weights: npt.NDArray[np.float32]
    top: int
    reach_x: int
    reach_y: int
    length: int

    @property
    def nbytes(self) -> int:
        return self.spectra.nbytes


CACHE = BytesCache(limit=320 * 2**20)


def blur(frame: Frame, field: PsfField) -> npt.NDArray[np.float32]:
    """Convolve an image with the PSF at each of its points."""
    height, width = frame.shape[:2]
    kernels = CACHE.get((field.digest, height, width), lambda: _kernels(field, height, width))
    columns = Axis.of(width, grid_of(height, width))
    window = columns.windows.shape[1]
    margin = columns.starts[-1] - kernels.reach_x + kernels.length - width
    pixels = _padded_columns(frame, margin, kernels.reach_y)
    weights = columns.windows.astype(np.float32)[..., None]
    total = np.zeros((3, pixels.shape[1], height), np.float32)
    for column, start in enumerate(columns.starts):
        inside = slice(start + margin, start + margin + window)
        left = inside.start - kernels.reach_x
        strip = _blur_strip(pixels[:, left:], pixels[:, ::-1][:, left:], kernels, column, height)
        strip = strip[:, :, :window] * weights[column]
        total[:, inside] += strip[0]
        total[:, ::-1][:, inside] += strip[1]
    return np.asarray(total[:, margin : margin + width].transpose(2, 1, 0) + np.float32(GREY))


def _blur_strip(
    plain: npt.NDArray[np.float32], mirrored: npt.NDArray[np.float32], kernels: Kernels, column: int, height: int
) -> npt.NDArray[np.float32]:
    """Blur the part of an image that is affected by one column of nodes, and the same part of the mirrored image."""
    length, rows = kernels.length, height + 2 * kernels.reach_y
    work = np.empty((3, plain.shape[2] // BLOCK, length, 2, BLOCK), np.float32)
    for part, image in enumerate((plain, mirrored)):
        work[..., part, :] = image[:, :length].reshape(3, length, -1, BLOCK).transpose(0, 2, 1, 3)
    transform(work, twiddles(length))
    blurred = np.empty((3, -(-height // BLOCK), length, 2, BLOCK), np.float32)
    convolve_rows(kernels.spectra[column], work, (rows, height), kernels.firsts, kernels.weights, kernels.top, blurred)
    transform(blurred, twiddles(length))  # swapping real and imaginary parts turns the transform into its inverse
    inside = blurred[:, :, 2 * kernels.reach_x :, ::-1].transpose(3, 0, 2, 1, 4)
    return inside.reshape(*inside.shape[:3], -1)[..., :height]


def _padded_columns(frame: Frame, margin_x: int, margin_y: int) -> npt.NDArray[np.float32]:
    """Pad an image by reflection to a multiple of BLOCK rows, subtract `GREY` and return it as columns, (3, X, Y)."""
    spare_rows = -(frame.shape[0] + 2 * margin_y) % BLOCK
    margins = (margin_y, margin_y + spare_rows, margin_x, margin_x)
    continued = cv2.copyMakeBorder(frame, *margins, cv2.BORDER_REFLECT_101).transpose(2, 1, 0)
    return continued.astype(np.float32, order="C") - np.float32(GREY)


def _kernels(field: PsfField, height: int, width: int) -> Kernels:
    """Return the kernels of all nodes, cropped to the rows and columns that are non-zero in at least one kernel."""
    pitch = grid_of(height, width)
    rows, columns = Axis.of(height, pitch), Axis.of(width, pitch)
    nodes, corner = rows.offsets.size, math.sqrt(height * height + width * width) / 2.0
    kernels = np.empty((columns.offsets.size, nodes, 3, SIZE, SIZE), np.float32)
    of_column = np.empty(kernels.shape[1:])
    for column, dx in enumerate(columns.offsets):
        kernels_at(field.stack, np.full(nodes, dx), rows.offsets, corner, of_column)
        kernels[column] = of_column
    used = kernels.reshape(-1, SIZE, SIZE).any(axis=0)
    y, x = (int(np.abs(places - _REACH).max()) for places in np.nonzero(used))
    kernels = kernels[..., _REACH - y : _REACH + y + 1, _REACH - x : _REACH + x + 1][..., ::-1, :]
    length = transform_length(2 * pitch + 2 * x)
    padded_lags = -(-kernels.shape[3] // UNROLL) * UNROLL
    spectra = np.zeros((*kernels.shape[:3], length // 2 + 1, padded_lags, 2), np.float32)
    work = np.zeros((nodes, 3, length, 2, BLOCK), np.float32)
    for column in range(columns.offsets.size):
        work[:] = 0
        work[:, :, : 2 * x + 1, 0, : 2 * y + 1] = kernels[column].swapaxes(2, 3) / np.float32(length)
        transform(work, twiddles(length))
        spectra[column, ..., : 2 * y + 1, :] = work[:, :, : length // 2 + 1, :, : 2 * y + 1].swapaxes(3, 4)
    top = max(rows.starts[0], 0)
    firsts, weights = _blending(rows, top, height)
    return Kernels(spectra, firsts, weights, top, x, y, length)


def _blending(rows: Axis, top: int, height: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """Return, for each chunk of rows starting at `top`, the first node with a non-zero weight, and the node weights."""
    nodes, window = rows.windows.shape
    by_row = np.zeros((nodes, height + CHUNK), np.float32)
    for node, start in enumerate(rows.starts):
        inside = slice(max(start, 0), min(start + window, height))
        by_row[node, inside] = rows.windows[node, inside.start - start : inside.stop - start]
    chunks = [by_row[:, begin : begin + CHUNK] for begin in range(top, height, CHUNK)]
    used = [np.flatnonzero(chunk.any(axis=1)) for chunk in chunks]
    groups = max(-(-(nodes_[-1] - nodes_[0] + 1) // 4) for nodes_ in used)
    weights = np.zeros((len(chunks), 4 * groups, CHUNK), np.float32)
    for number, (chunk, nodes_) in enumerate(zip(chunks, used, strict=True)):
        weights[number, : nodes_[-1] - nodes_[0] + 1] = chunk[nodes_[0] : nodes_[-1] + 1]
    return np.array([nodes_[0] for nodes_ in used]), weights.reshape(len(chunks), -1)
