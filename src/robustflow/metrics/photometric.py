"""Measure how well a flow explains a pair of frames, without ground truth: the photometric error. Find out from the
frames whether a flow is not (u right, v down) in pixels from frame 1 to frame 2.

At a pixel, it is |frame 1 - frame 2 at the pixel's target| in grey levels, the means of R, G and B. Frame 2 is
interpolated bilinearly at targets rounded to 1/256 px. Only pixels whose target lies inside frame 2 count. The pixels
are computed and summed in integers, so the sums are bit-identical on every machine.

A flow in a wrong format becomes right when it is read differently: with swapped components, other signs, a factor, or
its rows in reverse order. If frame 2 warped by such a reading explains frame 1 clearly better than the flow as it is,
the format is wrong. This judges a model's flow and ground truth alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit_late
from ..core.types import Flow, Frame, Sample
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
    return _compared(frame1, _columns(rows if step == 1 else np.ascontiguousarray(frame2)), flow, step)


def _columns(frame2: Frame) -> npt.NDArray[np.int64]:
    """Return frame 2 as it is interpolated, (H, W + 1): a pixel in the low 32 bits, the one below in the high."""
    columns = np.empty((frame2.shape[0], frame2.shape[1] + 1), np.int64)
    _fill(frame2, columns)
    return columns


def _compared(frame1: Frame, columns: npt.NDArray[np.int64], flow: Flow, step: int) -> Photometric:
    errors, sums = np.empty(flow.shape[:2], np.int32), np.empty(3, np.int64)
    _compare(frame1, columns, flow, step, errors, sums)
    n, total, still = sums.tolist()
    return Photometric(n, total / UNIT, still / 3, errors)


@njit_late(f"void({_FRAME_TYPE}, int64[:, ::1])", cache=True)
def _fill(frame2: Any, columns: Any) -> None:
    """Store each pixel's grey sum and that of the pixel below in one int64, so that one lookup reads two rows."""
    height, width = frame2.shape[0], frame2.shape[1]
    for y in range(height - 1, -1, -1):
        for x in range(width):
            here = np.int64(frame2[y, x, 0]) + frame2[y, x, 1] + frame2[y, x, 2]
            below = columns[y + 1, x] & 0xFFFFFFFF if y + 1 < height else here
            columns[y, x] = here | below << 32
        columns[y, width] = columns[y, width - 1]


@njit_late(f"void({_FRAME_TYPE}, int64[:, ::1], {FLOW_TYPE}, int64, int32[:, ::1], int64[::1])", cache=True)
def _compare(frame1: Any, columns: Any, flow: Any, step: Any, errors: Any, sums: Any) -> None:
    """Interpolate frame 2 at each pixel's target, in 1/256 px, and add up differences, all in exact integers."""
    height, width = columns.shape[0], columns.shape[1] - 1
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
_CLEAR_OF_CONSTANT = 0.3
"""As `_CLEAR`, for ground truth with one vector: where the exposure changes, other regions can fit better by chance."""
_LEAST_GAIN = 0.5
"""Smallest gain of a clearly better reading, in grey levels: less can be noise."""
_LEAST_SHARE, _LEAST_PIXELS = 0.05, 256
"""Smallest fraction of the pixels, and smallest number of them, that a comparison needs."""
_LEAST_INSIDE = 0.5
"""Smallest fraction of the targets that are inside the frame with a clearly better reading."""
_ABOUT_EQUAL = 1.25
"""Readings with errors within this factor of the best are about as good; the simplest of them is named."""
_CONSTANT = 0.05
"""Standard deviation of vectors, relative to their length, up to which they count as one vector."""
_MOST_PIXELS = 100_000
_FACTORS = (2.0, 4.0, 8.0, 16.0, 0.5, 0.25, 0.125, 0.0625)
_FINE_FACTORS = tuple(2.0 ** (half / 2) for half in range(-12, 13))
"""Further factors of ground truth, up to 64, the factor of KITTI's files."""

Pair = tuple[Frame, Frame, Flow]
"""Frame 1, frame 2, and the flow between them."""


class Reading(NamedTuple):
    """A way to read a flow."""

    swapped: bool = False
    signs: tuple[int, int] = (1, 1)
    unit: str = "px"
    factor: float = 1.0
    flipped: str = ""

    def of(self, flow: Flow, height: int, width: int) -> Flow:
        """Return the vectors that result from reading a flow between frames of this size this way."""
        size = {"px": (1, 1), "frame": (width, height), "half frame": (width / 2, height / 2)}[self.unit]
        factors = np.array(self.signs) * np.array(size) * self.factor
        return np.ascontiguousarray((flow[..., ::-1] if self.swapped else flow) * factors.astype(np.float32))

    def describe(self) -> str:
        """Describe the flow that has to be read this way."""
        kind = {"": "", "rows": "upside down", "columns": "mirrored"}[self.flipped]
        words = [f"{kind} (its {self.flipped} are in reverse order)"] if kind else []
        if self.swapped:
            words.append("swapped to (v, u)")
        if self.signs == (-1, -1):
            words.append("backward (negated, or from frame 2 to frame 1)")
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
    outside: bool = False
    """Whether almost all targets are outside frame 2, so that `given` is the error without motion."""

    def describe(self) -> str:
        """Describe the evidence."""
        warped = "without motion (almost all its targets are outside)" if self.outside else "warped by it"
        return (
            f"frame 2 {warped} differs from frame 1 by {self.given:.1f} grey levels, and by {self.error:.1f} if the "
            "flow is corrected for this"
        )


def misread(pairs: Sequence[Pair], truth: bool = False) -> Misread | None:
    """Return the reading that explains the pairs clearly better than their flows as they are; None without evidence.

    Args:
        pairs: pairs with their flows, NaN where unknown.
        truth: whether the flows are ground truth: the same vector everywhere is evidence too, although a model can hit
            on a reading of it by chance, and more factors are tried.
    """
    thin = [_Thin(*pair) for pair in pairs]
    vectors = np.concatenate([pair.flow[np.isfinite(pair.flow).all(axis=2)] for pair in thin])
    varied = len(vectors) and np.hypot(*vectors.std(axis=0)) > _CONSTANT * np.hypot(*vectors.T).mean()
    if not varied and not truth:
        return None
    better = [result for reading in _readings(truth) if (result := _judged(thin, reading, not varied)) is not None]
    if not better:
        return None
    best = min(result.error / result.given for result in better)
    return next(result for result in better if result.error / result.given <= _ABOUT_EQUAL * best)


def misread_truth(sample: Sample) -> Misread | None:
    """Return the reading that explains a pair clearly better than its ground truth; None without evidence or truth."""
    if sample.flow is None or sample.valid is None:
        return None
    flow = np.where(sample.valid[..., None], sample.flow, np.float32(np.nan))
    return misread([(sample.frames[0], sample.frames[1], flow)], truth=True)


def _readings(truth: bool) -> Iterator[Reading]:
    """Yield all readings but the right one, the simplest first."""
    orders = list(product((False, True), ((1, 1), (-1, -1), (1, -1), (-1, 1))))
    for unit, factor in (("px", 1.0), ("frame", 1.0), ("half frame", 1.0), *(("px", factor) for factor in _FACTORS)):
        for swapped, signs in orders:
            if (swapped, signs, unit, factor) != Reading()[:4]:
                yield Reading(swapped, signs, unit, factor)
    if truth:
        yield from (Reading(factor=factor) for factor in _FINE_FACTORS if factor not in (1.0, *_FACTORS))
        for flipped, mirrored in (("rows", (1, -1)), ("columns", (-1, 1))):
            yield from (Reading(signs=signs, flipped=flipped) for signs in ((1, 1), mirrored))


class _Thin:
    """Every n-th row of a pair, so that large frames take no longer, and the errors that readings are compared with."""

    def __init__(self, frame1: Frame, frame2: Frame, flow: Flow) -> None:
        self._size, self._step = frame2.shape[:2], -(-flow.shape[0] * flow.shape[1] // _MOST_PIXELS)
        self._whole, self._columns = flow, _columns(np.ascontiguousarray(frame2))
        self._frame1: Frame = np.ascontiguousarray(frame1[:: self._step])
        self.flow: Flow = np.ascontiguousarray(flow[:: self._step])
        errors, self.still = self._errors(self.flow), self._errors(np.zeros_like(self.flow))
        self.known = np.count_nonzero(np.isfinite(self.flow[..., 0]))
        self.outside = np.count_nonzero(errors >= 0) < _LEAST_SHARE * self.known
        """Whether almost no pixel has a target inside the frame; then readings are compared with zero flow."""
        self.given = self.still if self.outside else errors

    def read(self, reading: Reading) -> npt.NDArray[np.int32]:
        """Return the errors of a reading."""
        whole = {"": self._whole, "rows": self._whole[::-1], "columns": self._whole[:, ::-1]}[reading.flipped]
        return self._errors(reading.of(whole[:: self._step], *self._size))

    def _errors(self, flow: Flow) -> npt.NDArray[np.int32]:
        return _compared(self._frame1, self._columns, flow, self._step).errors


def _judged(pairs: Sequence[_Thin], reading: Reading, constant: bool) -> Misread | None:
    """Compare a reading with the flow as it is, over the pixels whose targets are inside the frame in both."""
    sums = np.zeros(6, np.int64)
    for pair in pairs:
        errors = pair.read(reading)
        both = (errors >= 0) & (pair.given >= 0)
        over_both = (values[both].sum(dtype=np.int64) for values in (errors, pair.still, pair.given))
        sums += np.array([both.sum(), (errors >= 0).sum(), pair.known, *over_both])
    n, inside, known, error, still, given = sums.tolist()
    if n < max(_LEAST_PIXELS, _LEAST_SHARE * known) or inside < _LEAST_INSIDE * known:
        return None
    oriented = (reading.swapped, reading.signs) != (False, (1, 1)) or reading.flipped
    limit = _CLEAR_OF_TWO if oriented and (reading.unit, reading.factor) != ("px", 1.0) else _CLEAR
    limit = _CLEAR_OF_CONSTANT if constant else limit
    clear = error < limit * min(given, still) and given - error > _LEAST_GAIN * UNIT * n
    outside = all(pair.outside for pair in pairs)
    return Misread(reading, error / UNIT / n, given / UNIT / n, outside) if clear else None
