"""Blur an image with a spatially varying PSF, interpolated between columns of nodes with triangular windows.

The arithmetic is in `strip.py`. See docs/optics.md for the error relative to exact kernels and the run time.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.types import Frame
from .psf_field import SUPPORT, Axis, PsfField, grid_of, kernels_at
from .strip import BLOCK, CHUNK, UNROLL, convolve_rows, transform, transform_length, twiddles

GREY = 128.0
"""Grey level subtracted from all pixels, because sums of smaller numbers have smaller rounding errors."""

_REACH = SUPPORT // 2


class Kernels(NamedTuple):
    """The kernels of a PSF field for one image size."""

    spectra: npt.NDArray[np.float32]
    firsts: npt.NDArray[np.int64]
    weights: npt.NDArray[np.float32]
    top: int
    reach_x: int
    reach_y: int
    length: int


class KernelCache:
    """A cache of kernels by (field, height, width); above a limit in bytes, the least recently used ones are
    removed.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._entries: OrderedDict[tuple[str, int, int], Kernels] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: tuple[str, int, int], compute: Callable[[], Kernels]) -> Kernels:
        """Return the kernels for a key, computing them if they are not cached."""
        with self._lock:
            kernels = self._entries.pop(key, None)
        kernels = compute() if kernels is None else kernels
        with self._lock:
            self._entries[key] = kernels
            while self.nbytes > self.limit:
                self._entries.popitem(last=False)
        return kernels

    @property
    def nbytes(self) -> int:
        """Total size of the cached kernels in bytes."""
        return sum(kernels.spectra.nbytes for kernels in self._entries.values())


CACHE = KernelCache(limit=320 * 2**20)


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
    kernels = np.empty((columns.offsets.size, nodes, 3, SUPPORT, SUPPORT), np.float32)
    of_column = np.empty(kernels.shape[1:])
    for column, dx in enumerate(columns.offsets):
        kernels_at(field.stack, np.full(nodes, dx), rows.offsets, corner, of_column)
        kernels[column] = of_column
    used = kernels.reshape(-1, SUPPORT, SUPPORT).any(axis=0)
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
