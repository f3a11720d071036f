"""Single values of a blurred image, as `blur` defines them."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .blur import REACH, KernelCache, reflected
from .psf_field import PsfField
from .tiles import SUPPORT, Axis, grid_of, kernels_at

_KERNELS: KernelCache[npt.NDArray[np.float64]] = KernelCache(limit=64 * 2**20)


class ExactValues:
    """The weighted sum of what the nodes around a pixel make of it.

    Args:
        frame, field: as of `blur`.

    >>> from robustflow.psf.blur import blur
    >>> from robustflow.psf.shipped import shipped_field
    >>> frame, field = np.arange(2700, dtype=np.uint8).reshape(30, 30, 3), shipped_field(1)
    >>> bool(abs(ExactValues(frame, field).value(3, 4, 1) - blur(frame, field)[3, 4, 1]) < 1e-11)
    True
    """

    def __init__(self, frame: Frame, field: PsfField) -> None:
        self._frame, self._field = frame, field
        height, width = frame.shape[:2]
        pitch, self._transform = grid_of(height, width)
        self._rows, self._columns = Axis.of(height, pitch), Axis.of(width, pitch)

    def value(self, y: int, x: int, channel: int) -> float:
        """Of a pixel, in grey levels, within 10^-11 of that in `blur`."""
        total = 0.0
        plane = self._frame[..., channel]
        for row, turned, weight_y in _nodes_at(self._rows, y):
            lags_y, inputs_y = self._lags(self._rows, row, turned, y)
            some = plane[inputs_y]
            for column, mirrored, weight_x in _nodes_at(self._columns, x):
                lags_x, inputs_x = self._lags(self._columns, column, mirrored, x)
                kernel = self._kernel(row, column, channel)
                total += weight_y * weight_x * float(np.vdot(kernel[lags_y][:, lags_x], some[:, inputs_x]))
        return total

    def _lags(
        self, axis: Axis, node: int, turned: bool, place: int
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """What the transform of a node takes in: how far before `place`, around its circle, and which pixels."""
        margin = axis.starts[-1] + self._transform - REACH - axis.length
        pixels = reflected(axis.length, margin)
        begin = axis.starts[node] + margin - REACH
        seen = axis.length - 1 - place if turned else place
        lags = (seen - axis.starts[node] + 2 * REACH - np.arange(self._transform)) % self._transform
        return lags, (pixels[::-1] if turned else pixels)[begin : begin + self._transform]

    def _kernel(self, row: int, column: int, channel: int) -> npt.NDArray[np.float64]:
        """The kernel whose spectrum is a node's in single precision, (N, N); it has noise beyond its 61 pixels."""
        height, width = self._frame.shape[:2]
        key = (f"{self._field.digest} {row} {column} {channel}", height, width)
        kernel = _KERNELS.get(key)
        if kernel is None:
            dx, dy = self._columns.offsets[column : column + 1], self._rows.offsets[row : row + 1]
            plain = np.empty((1, 1, SUPPORT, SUPPORT))
            kernels_at(self._field.colours[channel], dx, dy, math.hypot(height, width) / 2.0, plain)
            size = (self._transform, self._transform)
            spectrum = scipy.fft.rfft2(plain[0, 0], size).astype(np.complex64)
            kernel = scipy.fft.irfft2(spectrum.astype(np.complex128), size)
            _KERNELS.put(key, kernel)
        return np.asarray(kernel, np.float64)


def _nodes_at(axis: Axis, place: int) -> list[tuple[int, bool, float]]:
    """The nodes with a weight at a pixel: number, whether before the centre, weight."""
    nodes = []
    for turned in (False, True):
        seen = axis.length - 1 - place if turned else place
        for node, start in enumerate(axis.starts):
            weight = float(axis.windows[node, seen - start]) if 0 <= seen - start < axis.windows.shape[1] else 0.0
            if weight > 0.0:
                nodes.append((node, turned, weight))
    return nodes
