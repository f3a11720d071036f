"""Single values of a blurred image, as `blur` defines them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .blur import REACH, KernelCache, reflected
from .lag_sums import dot
from .psf_field import PsfField
from .tiles import SUPPORT, Axis, grid_of, kernels_at

Inputs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]
PlainKernel = Callable[[int, int, int], npt.NDArray[np.float64]]


class _KernelDifference(NamedTuple):
    """How much one kernel exceeds another, in units of `unit`."""

    kernel: npt.NDArray[np.int16]
    unit: float

    @property
    def nbytes(self) -> int:
        """Bytes held, but for a few."""
        return self.kernel.nbytes


_DIFFERENCES: KernelCache[_KernelDifference] = KernelCache(limit=96 * 2**20)


class ExactValues:
    """The weighted sum of what the nodes around a pixel make of it.

    Args:
        frame, field: as in `blur`.

    >>> from robustflow.psf.blur import blur
    >>> from robustflow.psf.shipped import shipped_field
    >>> frame, field = np.arange(2700, dtype=np.uint8).reshape(30, 30, 3), shipped_field(1)
    >>> bool(abs(ExactValues(frame, field).value(3, 4, 1) - blur(frame, field)[3, 4, 1]) < 1e-11)
    True
    """

    def __init__(self, frame: Frame, field: PsfField) -> None:
        self._planes, self._field = np.ascontiguousarray(frame.transpose(2, 0, 1)), field
        height, width = frame.shape[:2]
        pitch, self._transform = grid_of(height, width)
        self._rows, self._columns = Axis.of(height, pitch), Axis.of(width, pitch)
        self._pixels = [_pixels(axis, self._transform) for axis in (self._columns, self._rows)]

    def value(self, y: int, x: int, channel: int) -> float:
        """The value of a pixel in grey levels, within 10^-11 of that of `blur`."""
        total = 0.0
        for weight, row, column, (lags_y, inputs_y), (lags_x, inputs_x) in self._around(y, x):
            kernel = self._kernel(row, column, channel)[lags_y][:, lags_x]
            total += weight * float(np.vdot(kernel, self._planes[channel][inputs_y][:, inputs_x]))
        return total

    def noise(self, y: int, x: int, channel: int, grey: float, plain: PlainKernel) -> float:
        """How much more the value is than with other kernels, in grey levels, to within a thousandth of it.

        Args:
            y, x, channel: of the pixel.
            grey: what was subtracted from the pixels with those kernels, and added to the sum.
            plain: the other kernel of a node (row, column) and a channel, (61, N).
        """
        total = 0.0
        for weight, row, column, along_y, along_x in self._around(y, x):
            key = (f"{self._field.digest} {row} {column} {channel}", self._rows.length, self._columns.length)
            noise = _DIFFERENCES.get(key)
            if noise is None:
                difference = self._kernel(row, column, channel)
                difference[:SUPPORT] -= plain(row, column, channel)
                unit = max(float(np.abs(difference).max()), 1e-300) / 32767
                noise = _KernelDifference(np.rint(difference / unit).astype(np.int16), unit)
                _DIFFERENCES.put(key, noise)
            total += weight * noise.unit * dot(noise.kernel, self._planes[channel], grey, *along_y, *along_x)
        return total

    def _around(self, y: int, x: int) -> Iterator[tuple[float, int, int, Inputs, Inputs]]:
        """The nodes with a weight at a pixel: weight, row, column, and what their transforms take in."""
        columns = [
            (weight, node, self._inputs(self._columns, node, turned, x))
            for node, turned, weight in _nodes_at(self._columns, x)
        ]
        for row, turned, weight_y in _nodes_at(self._rows, y):
            along_y = self._inputs(self._rows, row, turned, y)
            for weight_x, column, along_x in columns:
                yield weight_y * weight_x, row, column, along_y, along_x

    def _inputs(self, axis: Axis, node: int, turned: bool, place: int) -> Inputs:
        """What the transform of a node takes in: how far before `place`, around its circle, and which pixels."""
        begin = axis.starts[node] - axis.starts[0]
        seen = axis.length - 1 - place if turned else place
        lags = (seen - axis.starts[node] + 2 * REACH - np.arange(self._transform)) % self._transform
        return lags, self._pixels[axis is self._rows][turned][begin : begin + self._transform]

    def _kernel(self, row: int, column: int, channel: int) -> npt.NDArray[np.float64]:
        """The kernel whose spectrum is a node's in single precision, (N, N); it has noise beyond its 61 pixels."""
        dx, dy = self._columns.offsets[column : column + 1], self._rows.offsets[row : row + 1]
        corner = math.hypot(self._rows.length, self._columns.length) / 2.0
        plain = np.empty((1, 1, SUPPORT, SUPPORT))
        kernels_at(self._field.colours[channel], dx, dy, corner, plain)
        size = (self._transform, self._transform)
        spectrum = scipy.fft.rfft2(plain[0, 0], size).astype(np.complex64)
        return np.asarray(scipy.fft.irfft2(spectrum.astype(np.complex128), size), np.float64)


def _pixels(axis: Axis, transform: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Which pixels the transforms of all nodes take in, from the first one's on: of the axis, and of it turned."""
    margin = axis.starts[-1] + transform - REACH - axis.length
    pixels = reflected(axis.length, margin)
    begin = axis.starts[0] + margin - REACH
    return np.ascontiguousarray(pixels[begin:]), np.ascontiguousarray(pixels[::-1][begin:])


def _nodes_at(axis: Axis, place: int) -> list[tuple[int, bool, float]]:
    """The nodes with a weight at a pixel: number, whether before the centre, weight."""
    nodes = []
    for turned in (False, True):
        seen = axis.length - 1 - place if turned else place
        after = bisect_right(axis.starts, seen)
        for node in range(max(after - 2, 0), after):
            place_in = seen - axis.starts[node]
            weight = float(axis.windows[node, place_in]) if place_in < axis.windows.shape[1] else 0.0
            if weight > 0.0:
                nodes.append((node, turned, weight))
    return nodes
