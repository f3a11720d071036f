"""Measure how well a flow explains a pair of frames, without ground truth: the photometric error. Find out from the
frames whether a flow is not (u right, v down) in pixels from frame 1 to frame 2.

At a pixel, it is |frame 1 - frame 2 at the pixel's target| in grey levels, the means of R, G and B. Frame 2 is
interpolated bilinearly at targets rounded to 1/256 px. Only pixels whose target lies inside frame 2 count. The pixels
are computed and summed in integers, so the sums are bit-identical on every machine.

A flow in a wrong format becomes right when it is read differently: with swapped components, other signs, or a factor.
If frame 2 warped by such a reading explains frame 1 clearly better than the flow as it is, the format is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit_late
from ..core.types import Flow, Frame
from .error_maps import FLOW_TYPE, dense, flow_array

UNIT = 3 * 256 * 256
"""Number of units of a map in one grey level: the sum of three channels, times the weights of the interpolation."""
_FRAME_TYPE = "Array(uint8, 3, 'C', readonly=True)"


class Photometric(NamedTuple):
    """The photometric error of a flow."""

    n: int
    total: float
    still: float
    errors: npt.NDArray[np.int32]


def photometric(frame1: Frame, frame2: Frame, flow: Flow, step: int = 1) -> Photometric:
    """Compare frame 1 with frame 2 warped by a flow."""
    frame1, rows, flow = dense(frame1, frame2[::step], flow_array(flow))
    frame2 = rows if step == 1 else np.ascontiguousarray(frame2)
    errors, sums = np.empty(flow.shape[:2], np.int32), np.empty(3, np.int64)
    columns = np.empty((frame2.shape[0], frame2.shape[1] + 1), np.int64)
    _compare(frame1, frame2, flow, step, columns, errors, sums)
    n, total, still = sums.tolist()
    return Photometric(n, total / UNIT, still / 3, errors)


@njit_late(
    f"void({_FRAME_TYPE}, {_FRAME_TYPE}, {FLOW_TYPE}, int64, int64[:, ::1], int32[:, ::1], int64[::1])", cache=True
)
def _compare(frame1: Any, frame2: Any, flow: Any, step: Any, columns: Any, errors: Any, sums: Any) -> None:
    """Compare the frames; `columns` is filled with frame 2: a pixel in the low 32 bits, the one below in the high."""
    height, width = frame2.shape[0], frame2.shape[1]
    for y in range(height - 1, -1, -1):
        for x in range(width):
            here = np.int64(frame2[y, x, 0]) + frame2[y, x, 1] + frame2[y, x, 2]
            below = columns[y + 1, x] & 0xFFFFFFFF if y + 1 < height else here
            columns[y, x] = here | below << 32
        columns[y, width] = columns[y, width - 1]
    n, total, still = 0, 0, 0
    for row in range(errors.shape[0]):
        y = row * step
        for x in range(width):
            to_x, to_y = x + np.float64(flow[row, x, 0]), y + np.float64(flow[row, x, 1])
            if not (to_x >= 0.0 and to_x <= width - 1.0 and to_y >= 0.0 and to_y <= height - 1.0):  # also NaN
                errors[row, x] = -1
                continue
            steps_x, steps_y = np.uint32(np.int32(to_x * 256.0 + 0.5)), np.uint32(np.int32(to_y * 256.0 + 0.5))
            left, top = steps_x >> np.uint32(8), steps_y >> np.uint32(8)
            right_part, lower_part = np.int64(steps_x & np.uint32(255)), np.int64(steps_y & np.uint32(255))
            column = columns[top, left]
            both = (column << 8) + right_part * (columns[top, left + np.uint32(1)] - column)
            above, below = both & 0xFFFFFFFF, both >> 32
            here = np.int64(frame1[row, x, 0]) + frame1[row, x, 1] + frame1[row, x, 2]
            error = abs((here << 16) - ((above << 8) + lower_part * (below - above)))
            errors[row, x] = error
            n += 1
            total += error
            still += abs(here - (columns[y, x] & 0xFFFFFFFF))
    sums[0], sums[1], sums[2] = n, total, still


_CLEAR = 0.7
"""A reading is clearly better if its photometric error is below this fraction of the error of the flow as it is, and of
zero flow."""
_CLEAR_OF_TWO = 0.5
"""As `_CLEAR`, for readings with two changes, which are many: one of them may fit a useless flow by chance."""
_LEAST_GAIN = 0.5
"""Smallest gain of a clearly better reading, in grey levels: less can be noise."""
_LEAST_SHARE = 0.05
"""Smallest fraction of the pixels that a comparison needs."""
_ABOUT_EQUAL = 1.25
"""Readings with errors within this factor of the best are about as good; the simplest of them is named."""
_CONSTANT = 0.05
"""Standard deviation of vectors, relative to their length, up to which they count as one vector."""
_MOST_PIXELS = 100_000
_FACTORS = (2.0, 4.0, 8.0, 16.0, 0.5, 0.25, 0.125, 0.0625)

Pair = tuple[Frame, Frame, Flow]
"""Frame 1, frame 2, and the flow between them."""


class Reading(NamedTuple):
    """A way to read a flow."""

    swapped: bool = False
    signs: tuple[int, int] = (1, 1)
    unit: str = "px"
    factor: float = 1.0

    def of(self, flow: Flow, height: int, width: int) -> Flow:
        """Return the flow that results from reading a flow between frames of this size this way."""
        size = {"px": (1, 1), "frame": (width, height), "half frame": (width / 2, height / 2)}[self.unit]
        factors = np.array(self.signs) * np.array(size) * self.factor
        return np.ascontiguousarray((flow[..., ::-1] if self.swapped else flow) * factors.astype(np.float32))

    def describe(self) -> str:
        """Describe the flow that has to be read this way."""
        words = ["swapped to (v, u)"] if self.swapped else []
        if self.signs == (-1, -1):
            words.append("backward (negated)")
        elif self.signs != (1, 1):
            words.append(f"inverted in {'u' if self.signs[0] < 0 else 'v'}")
        if self.unit != "px":
            words.append(f"divided by {'half ' * (self.unit == 'half frame')}the size of the frame")
        if self.factor != 1:
            length = "short" if self.factor > 1 else "long"
            words.append(f"about {max(self.factor, 1 / self.factor):.2g} times too {length}")
        return ", ".join(words)


class Misread(NamedTuple):
    """A reading that explains pairs clearly better than their flows as they are."""

    reading: Reading
    error: float
    given: float


def misread(pairs: Sequence[Pair]) -> Misread | None:
    """Return the reading that explains the pairs clearly better than their flows as they are; None without evidence."""
    thin = [_Thin(*pair) for pair in pairs]
    vectors = np.concatenate([pair.flow[pair.errors >= 0] for pair in thin])
    if not len(vectors) or np.hypot(*vectors.std(axis=0)) <= _CONSTANT * np.hypot(*vectors.T).mean():
        return None
    found = [one for reading in _readings() if (one := _compared(thin, reading)) is not None]
    if not found:
        return None
    best = min(one.error / one.given for one in found)
    return next(one for one in found if one.error / one.given <= _ABOUT_EQUAL * best)


def _readings() -> Iterator[Reading]:
    """Yield all readings but the right one, the simplest first."""
    orders = list(product((False, True), ((1, 1), (-1, -1), (1, -1), (-1, 1))))
    for unit, factor in (("px", 1.0), ("frame", 1.0), ("half frame", 1.0), *(("px", factor) for factor in _FACTORS)):
        for swapped, signs in orders:
            if (swapped, signs, unit, factor) != Reading():
                yield Reading(swapped, signs, unit, factor)


class _Thin:
    """Every n-th row of a pair, so that large frames take no longer, and the errors of its flow as it is."""

    def __init__(self, frame1: Frame, frame2: Frame, flow: Flow) -> None:
        self.frame2, self._step = frame2, -(-flow.shape[0] * flow.shape[1] // _MOST_PIXELS)
        self.frame1: Frame = np.ascontiguousarray(frame1[:: self._step])
        self.flow: Flow = np.ascontiguousarray(flow[:: self._step])
        self.errors = photometric(self.frame1, frame2, self.flow, self._step).errors

    def read(self, reading: Reading) -> Photometric:
        """Return the error of a reading at the pixels that also have a target as they are."""
        flow = reading.of(self.flow, *self.frame2.shape[:2])
        flow[self.errors < 0] = np.nan
        return photometric(self.frame1, self.frame2, flow, self._step)


def _compared(pairs: Sequence[_Thin], reading: Reading) -> Misread | None:
    """Compare a reading with the flow as it is, over the pixels whose targets are inside the frame in both."""
    n, error, still, given, known = 0, 0.0, 0.0, 0, 0
    for pair in pairs:
        found = pair.read(reading)
        n, error, still = n + found.n, error + found.total, still + found.still
        given += int(pair.errors[found.errors >= 0].sum(dtype=np.int64))
        known += int(np.count_nonzero(np.isfinite(pair.flow[..., 0])))
    if n < max(1, _LEAST_SHARE * known):
        return None
    one = Misread(reading, error / n, given / UNIT / n)
    oriented = (reading.swapped, reading.signs) != (False, (1, 1))
    limit = _CLEAR_OF_TWO if oriented and (reading.unit, reading.factor) != ("px", 1.0) else _CLEAR
    clear = one.error < limit * one.given and error < limit * still and one.given - one.error > _LEAST_GAIN
    return one if clear else None
