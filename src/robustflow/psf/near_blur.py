"""`blur` in single precision, in less than half its time.

One transform along x for every column of nodes, sums over lags along y (`lag_sums`), and one transform back; pixels are
held column by column, so that each step runs along contiguous memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .blur import REACH, KernelCache, results_in_order
from .lag_sums import LANES, lag_sums
from .psf_field import PsfField
from .threads import allowed_threads
from .tiles import SUPPORT, Axis, grid_of, kernels_at

GREY = 128.0
"""Subtracted from the pixels: sums of smaller numbers lose less."""


class NearKernels(NamedTuple):
    """The kernels of a field for an image size.

    Attributes:
        plain: float32 (columns of nodes, rows of nodes, 3, A, B), along x and y, last lag first, without the outer
            columns and rows that are zero in all of them.
        spectra: what `lag_sums` takes, for each column of nodes.
        reaches: int64 (columns of nodes, rows of nodes), the largest lag along y at which a kernel is not zero.
        transform: length of the transforms along x, pixels.
        gain: the largest sum of a kernel's absolute values, 1 unless it has negative ones: how much larger than in an
            image of the usual kind errors can be.
    """

    plain: npt.NDArray[np.float32]
    spectra: npt.NDArray[np.float32]
    reaches: npt.NDArray[np.int64]
    transform: int
    gain: float

    @property
    def nbytes(self) -> int:
        """Bytes held, but for a few."""
        return self.plain.nbytes + self.spectra.nbytes

    @property
    def reach(self) -> tuple[int, int]:
        """The largest lags along x and y."""
        return self.plain.shape[3] // 2, self.plain.shape[4] // 2

    def kernel(self, row: int, column: int, channel: int) -> npt.NDArray[np.float64]:
        """The kernel of a node, (61, 61) along y and x."""
        x, y = self.reach
        kernel = np.zeros((SUPPORT, SUPPORT))
        inner = kernel[REACH - y : REACH + y + 1, REACH - x : REACH + x + 1]
        inner[...] = self.plain[column, row, channel].T[::-1, ::-1]
        return kernel


class NearBlur(NamedTuple):
    """A blurred image, and what single values of it are computed from.

    Attributes:
        total: float32 (3, X, H), column by column, grey levels less `GREY`.
        pixels: float32 (3, X, Y), the image continued on all sides, column by column, less `GREY`.
        left, top: where the image begins in them.
        kernels: of the field.
    """

    total: npt.NDArray[np.float32]
    pixels: npt.NDArray[np.float32]
    left: int
    top: int
    kernels: NearKernels


def near_blur(frame: Frame, field: PsfField, threads: int | None = None) -> NearBlur:
    """Blur an image, nearly: to within 10^-4 grey levels (measured), on different machines in different ways.

    Args:
        frame, field, threads: as in `blur`.

    >>> from robustflow.psf.shipped import shipped_field
    >>> blurred = near_blur(np.full((20, 30, 3), 77, np.uint8), shipped_field(1))
    >>> float(blurred.total[0, blurred.left, 0] + GREY)
    77.0
    """
    height, width = frame.shape[:2]
    kernels = near_kernels(field, height, width)
    (reach_x, reach_y), transform = kernels.reach, kernels.transform
    pitch, _ = grid_of(height, width)
    window, rows, columns = 2 * pitch, Axis.of(height, pitch), Axis.of(width, pitch)
    margin_y = max(rows.starts[-1] + window - height, 0) + reach_y
    margin_x = columns.starts[-1] - reach_x + transform - width
    mirrored = _with_mirror_image(frame, margin_x, margin_y)
    tops = np.array(rows.starts) + margin_y
    row_windows, column_windows = rows.windows.astype(np.float32), columns.windows.astype(np.float32)

    def strip(column: int) -> npt.NDArray[np.float32]:
        """The contribution of a column of nodes to the image and to its left-right mirror image, (2, 3, W, H)."""
        left = columns.starts[column] + margin_x - reach_x
        along_x = scipy.fft.rfft(mirrored[:, :, left : left + transform], axis=-2).view(np.float32)
        sums = np.empty((2, 3, transform // 2 + 1, height), np.complex64)
        lag_sums(
            along_x,
            kernels.spectra[column],
            2 * reach_y + 1,
            kernels.reaches[column],
            tops,
            row_windows,
            sums.view(np.float32),
        )
        blurred = scipy.fft.irfft(sums, transform, axis=-2)[:, :, 2 * reach_x : 2 * reach_x + window]
        blurred *= column_windows[column][:, None]
        return np.asarray(blurred, np.float32)

    total = np.zeros((3, mirrored.shape[2], height), np.float32)
    for column, (plain, mirror) in enumerate(
        results_in_order(strip, len(columns.starts), threads or allowed_threads())
    ):
        left = columns.starts[column] + margin_x
        total[:, left : left + window] += plain
        total[:, ::-1][:, left : left + window] += mirror
    return NearBlur(total, mirrored[0], margin_x, margin_y, kernels)


def _with_mirror_image(frame: Frame, margin_x: int, margin_y: int) -> npt.NDArray[np.float32]:
    """An image continued by reflection, and its left-right mirror image, column by column, (2, 3, X, Y)."""
    margins = (margin_y, margin_y, margin_x, margin_x)
    continued = cv2.copyMakeBorder(frame, *margins, cv2.BORDER_REFLECT_101).transpose(2, 1, 0)
    mirrored = np.empty((2, *continued.shape), np.float32)
    for plane, values in zip(mirrored[0], continued, strict=True):
        plane[...] = values
        plane -= np.float32(GREY)
    mirrored[1] = mirrored[0, :, ::-1]
    return mirrored


_KERNELS: KernelCache[NearKernels] = KernelCache(limit=320 * 2**20)


def near_kernels(field: PsfField, height: int, width: int) -> NearKernels:
    """For a field and an image size; the most recently used are kept."""
    key = (field.digest, height, width)
    kept = _KERNELS.get(key)
    if kept is not None:
        return kept
    pitch, _ = grid_of(height, width)
    rows, columns = Axis.of(height, pitch), Axis.of(width, pitch)
    corner, nodes = math.hypot(height, width) / 2.0, rows.offsets.size
    plain = np.empty((columns.offsets.size, nodes, 3, SUPPORT, SUPPORT), np.float32)
    of_column = np.empty((nodes, 3, SUPPORT, SUPPORT))
    for column, dx in enumerate(columns.offsets):
        kernels_at(field.stack, np.full(nodes, dx), rows.offsets, corner, of_column)
        plain[column] = of_column.transpose(0, 1, 3, 2)[..., ::-1, ::-1]
    lags = np.abs(np.arange(-REACH, REACH + 1))
    reaches = np.where(plain.any(axis=(2, 3)), lags, 0).max(axis=-1)
    x = np.where(plain.any(axis=(0, 1, 2, 4)), lags, 0).max()
    y = reaches.max()
    plain = np.ascontiguousarray(plain[..., REACH - x : REACH + x + 1, REACH - y : REACH + y + 1])
    transform = scipy.fft.next_fast_len(int(2 * pitch + 2 * x), real=True)
    groups = (2 * y + LANES) // LANES + 1
    spectra = np.zeros((columns.offsets.size, 3, transform // 2 + 1, nodes, 2, LANES * groups), np.float32)
    for column in range(columns.offsets.size):
        along_x = scipy.fft.rfft(plain[column][:, :, ::-1], transform, axis=-2).transpose(1, 2, 0, 3)
        spectra[column, ..., 0, : 2 * y + 1], spectra[column, ..., 1, : 2 * y + 1] = along_x.real, along_x.imag
    gain = max(1.0, float(np.abs(plain).sum(axis=(3, 4)).max()))
    made = NearKernels(plain, spectra.reshape(*spectra.shape[:3], -1), reaches, transform, gain)
    _KERNELS.put(key, made)
    return made
