"""Single values of a blurred image, as `blur` defines them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .blur import REACH, KernelCache, reflected
from .close_values import dot
from .psf_field import PsfField
from .tiles import SUPPORT, Axis, grid_of, kernels_at

Inputs = tuple[int, npt.NDArray[np.int64]]
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
        plain: the kernel of a node (row, column) and a channel, (61, 61), with which values were computed before.

    >>> from robustflow.psf.blur import blur
    >>> from robustflow.psf.shipped import shipped_field
    >>> frame, field = np.arange(2700, dtype=np.uint8).reshape(30, 30, 3), shipped_field(1)
    >>> from robustflow.psf.near_blur import near_kernels
    >>> values = ExactValues(frame, field, near_kernels(field, 30, 30).kernel)
    >>> bool(abs(values.value(3, 4, 1) - blur(frame, field)[3, 4, 1]) < 1e-11)
    True
    """

    def __init__(self, frame: Frame, field: PsfField, plain: PlainKernel) -> None:
        self._planes, self._field, self._plain = np.ascontiguousarray(frame.transpose(2, 0, 1)), field, plain
        height, width = frame.shape[:2]
        pitch, self._transform = grid_of(height, width)
        self._rows, self._columns = Axis.of(height, pitch), Axis.of(width, pitch)
        self._pixels = [_pixels(axis, self._transform) for axis in (self._columns, self._rows)]

    def value(self, y: int, x: int, channel: int) -> float:
        """The value of a pixel in grey levels, within 10^-11 of that of `blur`."""
        total, steps = 0.0, np.arange(self._transform)
        for weight, row, column, (lag_y, inputs_y), (lag_x, inputs_x) in self._around(y, x):
            kernel = self._kernel(row, column, channel)[lag_y - steps][:, lag_x - steps]
            total += weight * float(np.vdot(kernel, self._planes[channel][inputs_y][:, inputs_x]))
        return total

    def noise(self, y: int, x: int, channel: int, grey: float) -> Iterator[tuple[float, float]]:
        """How much more the value is than with plain kernels.

        Args:
            y, x, channel: of the pixel.
            grey: what was subtracted from the pixels with those kernels, and added to the sum.

        Yields:
            The weight of each node, and in grey levels, to within a thousandth of it, what it adds, that of the
            greatest weight first; the weights add up to 1.
        """
        for weight, row, column, along_y, along_x in self._around(y, x):
            key = (f"{self._field.digest} {row} {column} {channel}", self._rows.length, self._columns.length)
            noise = _DIFFERENCES.get(key)
            if noise is None:
                difference = self._kernel(row, column, channel)
                difference[:SUPPORT, :SUPPORT] -= self._plain(row, column, channel)
                unit = max(float(np.abs(difference).max()), 1e-300) / 32767
                noise = _KernelDifference(np.rint(difference / unit).astype(np.int16), unit)
                _DIFFERENCES.put(key, noise)
            yield weight, noise.unit * dot(noise.kernel, self._planes[channel], grey, *along_y, *along_x)

    def _around(self, y: int, x: int) -> list[tuple[float, int, int, Inputs, Inputs]]:
        """The nodes with a weight at a pixel: weight, row, column, and what their transforms take in."""
        columns, rows = ((*axis.nodes_at_pixels, axis) for axis in (self._columns, self._rows))
        found = []
        for row, weight_y in zip(rows[0][y].tolist(), rows[1][y].tolist(), strict=True):
            for column, weight_x in zip(columns[0][x].tolist(), columns[1][x].tolist(), strict=True):
                weight = weight_y * weight_x
                if weight > 0.0:
                    along_y, along_x = self._inputs(self._rows, row, y), self._inputs(self._columns, column, x)
                    found.append((weight, max(row, ~row), max(column, ~column), along_y, along_x))
        return sorted(found, key=lambda node: -node[0])

    def _inputs(self, axis: Axis, node: int, place: int) -> Inputs:
        """What the transform of a node takes in: the lag of the first pixel, and all of them, one lag less each."""
        turned, node = node < 0, max(node, ~node)
        begin = axis.starts[node] - axis.starts[0]
        seen = axis.length - 1 - place if turned else place
        lag = (seen - axis.starts[node] + 2 * REACH) % self._transform
        return lag, self._pixels[axis is self._rows][turned][begin : begin + self._transform]

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
