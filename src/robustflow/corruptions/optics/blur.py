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

from ...core.compiled import njit
from ...core.types import Frame
from ..kernels.cache import BytesCache
from .psf_field import SIZE, Axis, PsfField, grid_of, kernels_at
from .row_convolution import BLOCK, CHUNK, GROUP, LANES, convolve_rows, work_arrays

LENGTHS = (24, 27, 32, 36, 48, 54, 64, 72, 81, 96, 108, 128)
"""Supported transform lengths, which are products of 2 and 3; the largest suffices for the widest window and kernel."""

_SIN_60 = np.float32(math.sqrt(3.0) / 2.0)
_HALF = np.float32(0.5)


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


@njit(cache=True, nogil=True, error_model="numpy")
def _transform(blocks: Any, spare: Any, roots: Any) -> None:
    """Transform each block, (length, 2 columns) as real and imaginary parts, in place: Stockham's FFT of radix 4, 3 and
    2."""
    length = roots.shape[0]
    for number in range(blocks.shape[0]):
        x, y = blocks[number], spare
        n, s, in_spare = length, 1, False
        while n > 1:
            radix = 4 if n % 4 == 0 else (3 if n % 3 == 0 else 2)
            m = n // radix
            for p in range(m):
                k = p * s
                w1r, w1i = roots[k, 0], roots[k, 1]
                w2r, w2i = roots[(2 * k) % length, 0], roots[(2 * k) % length, 1]
                w3r, w3i = roots[(3 * k) % length, 0], roots[(3 * k) % length, 1]
                for q in range(s):
                    a, e = q + s * p, q + s * radix * p
                    b, c, d = a + s * m, a + 2 * s * m, a + 3 * s * m
                    f, g, h = e + s, e + 2 * s, e + 3 * s
                    if radix == 2:
                        for i in range(BLOCK):
                            j = i + BLOCK
                            ur, ui = x[a, i] - x[b, i], x[a, j] - x[b, j]
                            y[e, i], y[e, j] = x[a, i] + x[b, i], x[a, j] + x[b, j]
                            y[f, i], y[f, j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                    elif radix == 3:
                        for i in range(BLOCK):
                            j = i + BLOCK
                            ar, ai = x[a, i], x[a, j]
                            br, bi = x[b, i], x[b, j]
                            cr, ci = x[c, i], x[c, j]
                            tr, ti = br + cr, bi + ci
                            dr, di = (br - cr) * _SIN_60, (bi - ci) * _SIN_60
                            hr, hi = ar - _HALF * tr, ai - _HALF * ti
                            y[e, i], y[e, j] = ar + tr, ai + ti
                            ur, ui = hr + di, hi - dr
                            y[f, i], y[f, j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                            ur, ui = hr - di, hi + dr
                            y[g, i], y[g, j] = ur * w2r - ui * w2i, ur * w2i + ui * w2r
                    else:
                        for i in range(BLOCK):
                            j = i + BLOCK
                            ar, ai = x[a, i], x[a, j]
                            br, bi = x[b, i], x[b, j]
                            cr, ci = x[c, i], x[c, j]
                            dr, di = x[d, i], x[d, j]
                            t0r, t0i = ar + cr, ai + ci
                            t1r, t1i = ar - cr, ai - ci
                            t2r, t2i = br + dr, bi + di
                            t3r, t3i = br - dr, bi - di
                            y[e, i], y[e, j] = t0r + t2r, t0i + t2i
                            ur, ui = t1r + t3i, t1i - t3r
                            y[f, i], y[f, j] = ur * w1r - ui * w1i, ur * w1i + ui * w1r
                            ur, ui = t0r - t2r, t0i - t2i
                            y[g, i], y[g, j] = ur * w2r - ui * w2i, ur * w2i + ui * w2r
                            ur, ui = t1r - t3i, t1i + t3r
                            y[h, i], y[h, j] = ur * w3r - ui * w3i, ur * w3i + ui * w3r
            n, s, x, y, in_spare = m, s * radix, y, x, not in_spare
        if in_spare:
            for t in range(length):
                for i in range(2 * BLOCK):
                    blocks[number, t, i] = spare[t, i]


GREY = 128.0
"""Grey level subtracted from all pixels, because sums of smaller numbers have smaller rounding errors."""

_REACH = SIZE // 2


class Kernels(NamedTuple):
    spectra: npt.NDArray[np.float32]
    groups: npt.NDArray[np.int64]
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
    margin = columns.starts[-1] - kernels.reach_x + kernels.length - width
    pixels = _padded_columns(frame, margin, kernels.reach_y)
    weights, reach, length = columns.windows.astype(np.float32), kernels.reach_x, kernels.length
    total = np.zeros((3, pixels.shape[1], -(-height // BLOCK), BLOCK), np.float32)
    strip = np.empty((3, pixels.shape[2] // BLOCK, length, 2, BLOCK), np.float32)
    shape = height + 2 * kernels.reach_y, height
    work = work_arrays(shape[0], kernels.top, LANES * len(kernels.groups))
    blurred = np.zeros((3, total.shape[2], length, 2, BLOCK), np.float32)
    for column, start in enumerate(columns.starts):
        left = start + margin - reach
        for part, image in enumerate((pixels, pixels[:, ::-1])):
            columns_ = image[:, left : left + length].reshape(3, length, -1, BLOCK)
            strip[..., part, :] = columns_.transpose(0, 2, 1, 3)
        transform(strip, twiddles(length))
        convolve_rows(
            kernels.spectra[column], strip, shape, kernels.groups, kernels.weights, kernels.top, work, blurred
        )
        transform(blurred, twiddles(length))  # swapping real and imaginary parts turns the transform into its inverse
        span = slice(2 * reach, 2 * reach + weights.shape[1])
        for part, image in enumerate((total, total[:, ::-1])):
            strips = blurred[:, :, span, 1 - part] * weights[column, :, None]
            image[:, start + margin :][:, : weights.shape[1]] += strips.swapaxes(1, 2)
    inside = total.reshape(3, pixels.shape[1], -1)[:, margin : margin + width, :height]
    return np.asarray(inside.transpose(2, 1, 0) + np.float32(GREY))


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
    spectra = np.zeros((*kernels.shape[:3], length // 2 + 1, 2 * y + 1, 2), np.float32)
    work = np.zeros((nodes, 3, length, 2, BLOCK), np.float32)
    for column in range(columns.offsets.size):
        work[:] = 0
        work[:, :, : 2 * x + 1, 0, : 2 * y + 1] = kernels[column].swapaxes(2, 3) / np.float32(length)
        transform(work, twiddles(length))
        spectra[column] = work[:, :, : length // 2 + 1, :, : 2 * y + 1].swapaxes(3, 4)
    top = max(rows.starts[0], 0)
    groups, weights = _blending(rows, top, height)
    return Kernels(spectra, groups, weights, top, x, y, length)


def _blending(rows: Axis, top: int, height: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """Return, for each LANES rows from `top`, the number and the first nodes of the groups with non-zero weights, and
    the weights.

    The groups of CHUNK rows follow their first node with a non-zero weight, so each sum has the same order everywhere.
    """
    nodes, window = rows.windows.shape
    weights = np.zeros((nodes + GROUP, height - top + CHUNK), np.float32)
    for node, start in enumerate(rows.starts):
        begin, end = max(start, top), min(start + window, height)
        weights[node, begin - top : end - top] = rows.windows[node, begin - start : end - start]
    groups = []
    for begin in range(0, height - top, LANES):
        chunk = weights[:, begin // CHUNK * CHUNK :][:, :CHUNK]
        first, end = np.flatnonzero(chunk.any(axis=1))[[0, -1]]
        of_lanes = weights[:, begin : begin + LANES]
        groups.append([node for node in range(first, end + 1, GROUP) if of_lanes[node : node + GROUP].any()])
    most = max(map(len, groups))
    return np.array([[len(used), *used] + [0] * (most - len(used)) for used in groups], np.int64), weights
