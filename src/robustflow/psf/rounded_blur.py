"""The bytes of `blur`, in less than half its time: a faster sum decides nearly all of them, `blur` the others.

`blur` keeps its kernels' spectra in single precision. Compared with kernels that are not rounded this is noise over the
whole transform, of 10^-6 grey levels (root mean square; at most 8 x 10^-6 in 42 million values of KITTI, 10^-5 in
black-and-white noise). A value that lies `MARGIN` or more from the middle between two grey levels is on the same side
of it with either. To those that lie closer, about fifty a frame, the noise is added, from a table of its own; what is
then still closer than `FINE` is computed as `blur` defines it, value by value, and ties by `blur` itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .blur import REACH, KernelCache, blur, reflected, results_in_order
from .exact_values import ExactValues
from .lag_sums import add_strip, lag_sums, round_all
from .psf_field import PsfField
from .threads import allowed_threads
from .tiles import SUPPORT, Axis, grid_of, kernels_at

MARGIN = 2e-5
"""Grey levels; about 15 times the noise where it is largest: black and white at random under severity 1."""

FINE = 2e-7
"""Grey levels; ten times the error that is left when the noise was added."""

TIE = 1e-9
"""Grey levels; closer to the middle than this, the last bits of `blur` decide, which only `blur` itself knows."""

MOST = 1000
"""Values of an image that are computed one by one; with more of them `blur` is quicker."""

GREY = 128.0
"""Subtracted from the pixels: sums of smaller numbers lose less."""


def rounded_blur(frame: Frame, field: PsfField, threads: int | None = None) -> Frame:
    """`blur`, rounded to the nearest grey level, halves to the even one.

    Args:
        frame: RGB uint8 (H, W, 3), any size.
        field: the PSFs.
        threads: as in `blur`.

    Returns:
        uint8 (H, W, 3), on every machine the bytes that `blur` rounds to.

    >>> from robustflow.psf.shipped import shipped_field
    >>> int(rounded_blur(np.full((20, 30, 3), 77, np.uint8), shipped_field(1)).min())
    77
    """
    total, left = _near_blur(frame, field, threads)
    rounded = np.empty(frame.shape, np.uint8)
    close = np.empty((MOST, 3), np.int64)
    count = round_all(total, left, MARGIN, rounded, close)
    if count > MOST:
        return _rounded(blur(frame, field, threads))
    exact = ExactValues(frame, field) if count else None
    for y, x, channel in close[:count].tolist():
        assert exact is not None
        value = float(total[channel, y, left + x]) + exact.noise(
            y, x, channel, GREY, _lag_kernels(field, *frame.shape[:2]).kernel
        )
        if _from_middle(value) < FINE:
            value = exact.value(y, x, channel)
            if _from_middle(value) < TIE:
                return _rounded(blur(frame, field, threads))
        rounded[y, x, channel] = _rounded(value)
    return rounded


def _from_middle(value: float) -> float:
    return abs(value - math.floor(value) - 0.5)


def _rounded(values: npt.ArrayLike) -> Frame:
    return np.clip(np.rint(values), 0.0, 255.0).astype(np.uint8)


def _near_blur(frame: Frame, field: PsfField, threads: int | None) -> tuple[npt.NDArray[np.float64], int]:
    """`blur` to within less than `MARGIN`, (3, H, more than W), and the column of it at which the image begins."""
    height, width = frame.shape[:2]
    pitch, transform = grid_of(height, width)
    rows, columns = Axis.of(height, pitch), Axis.of(width, pitch)
    margin_y, margin_x = (axis.starts[-1] + transform - REACH - axis.length for axis in (rows, columns))
    planes = np.ascontiguousarray(frame.transpose(2, 0, 1))
    padded = planes[:, reflected(height, margin_y)][:, :, reflected(width, margin_x)]
    mirrored = np.stack([padded, padded[..., ::-1]]).astype(np.float64)
    mirrored -= GREY
    tops = np.array(rows.starts) + margin_y
    lags = _lag_kernels(field, height, width)

    def strip(column: int) -> npt.NDArray[np.float64]:
        """The contribution of a column of nodes to the image and to its left-right mirror image."""
        left = columns.starts[column] + margin_x - REACH
        along_rows = scipy.fft.rfft(mirrored[..., left : left + transform]).view(np.float64)
        sums = np.empty((2, 3, height, transform // 2 + 1), np.complex128)
        lag_sums(along_rows, lags.kernels[column], lags.reaches[column], tops, rows.windows, sums.view(np.float64))
        return np.asarray(scipy.fft.irfft(sums, transform, overwrite_x=True), np.float64)

    total = np.full((3, height, padded.shape[2]), GREY)
    for column, blurred in enumerate(results_in_order(strip, len(columns.starts), threads or allowed_threads())):
        add_strip(blurred, columns.windows[column], columns.starts[column] + margin_x, total)
    return total, margin_x


class _LagKernels(NamedTuple):
    """What `lag_sums` takes, for every column of nodes."""

    kernels: npt.NDArray[np.float32]
    reaches: npt.NDArray[np.int64]
    transform: int

    @property
    def nbytes(self) -> int:
        """Bytes held, but for a few."""
        return self.kernels.nbytes

    def kernel(self, row: int, column: int, channel: int) -> npt.NDArray[np.float64]:
        """The kernel of a node, (61, N)."""
        real, imaginary = self.kernels[column, channel, :, row].astype(np.float64).transpose(1, 2, 0)[:, ::-1]
        return np.asarray(scipy.fft.irfft(real + 1j * imaginary, self.transform), np.float64)


_KERNELS: KernelCache[_LagKernels] = KernelCache(limit=128 * 2**20)


def _lag_kernels(field: PsfField, height: int, width: int) -> _LagKernels:
    """For a field and an image size; the most recently used are kept."""
    key = (field.digest, height, width)
    kept = _KERNELS.get(key)
    if kept is not None:
        return kept
    pitch, transform = grid_of(height, width)
    rows, columns = Axis.of(height, pitch), Axis.of(width, pitch)
    corner, nodes = math.hypot(height, width) / 2.0, rows.offsets.size
    lags = np.empty((columns.offsets.size, 3, transform // 2 + 1, nodes, 2, SUPPORT), np.float32)
    reaches = np.empty((columns.offsets.size, nodes), np.int64)
    plain = np.empty((nodes, 3, SUPPORT, SUPPORT))
    for column, dx in enumerate(columns.offsets):
        kernels_at(field.stack, np.full(nodes, dx), rows.offsets, corner, plain)
        spectra = scipy.fft.rfft(plain[:, :, ::-1], transform).transpose(1, 3, 0, 2)
        lags[column, ..., 0, :], lags[column, ..., 1, :] = spectra.real, spectra.imag
        reaches[column] = np.where(plain.any(axis=(1, 3)), np.abs(np.arange(-REACH, REACH + 1)), 0).max(axis=1)
    made = _LagKernels(lags, reaches, transform)
    _KERNELS.put(key, made)
    return made
