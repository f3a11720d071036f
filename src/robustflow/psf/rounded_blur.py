"""The bytes of `blur`, in less than half its time: a blur in single precision decides nearly all of them.

A value that is further from the middle between two grey levels than a first blur can be wrong is on the same side of it
in all. The others are computed again, each time with a smaller error:

1. `near_blur`: errors of 5 x 10^-5 grey levels at most in photographs, 9 x 10^-5 in stripes and checks. About 800 of
   a frame's 1.4 million values lie within `NEAR_MARGIN`.
2. `plain_sums`, value by value in double precision: what is left is that `blur` keeps its kernels' spectra in single
   precision, a noise of 10^-6 grey levels (root mean square) over the whole transform. About 50 lie within `MARGIN`.
3. That noise is added, node by node, from a table of its own, until the nodes that are left cannot turn the value.
4. What is then still closer than `FINE` is computed as `blur` defines it, and ties by `blur` itself.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..sample import Frame
from .blur import blur
from .close_values import plain_sums, round_all
from .exact_values import ExactValues
from .near_blur import GREY, NearBlur, near_blur
from .psf_field import PsfField
from .tiles import Axis, grid_of

NEAR_MARGIN = 3e-4
"""Grey levels, like the next three for kernels without negative values (see `NearKernels.gain`); three times the
largest error of `near_blur` in 27 kinds of images, six times that in photographs."""

MARGIN = 2e-5
"""Grey levels; about 15 times the noise where it is largest: black and white at random under severity 1."""

FINE = 2e-7
"""Grey levels; ten times the error that is left when the noise was added."""

TIE = 1e-9
"""Grey levels; closer to the middle than this, the last bits of `blur` decide, which only `blur` itself knows."""

MOST_NEAR = 1 / 20
"""Share of the values that is computed by `plain_sums`; with more of them `blur` is quicker."""

MOST = 1000
"""Values of an image to which noise is added, one by one; with more of them `blur` is quicker."""


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
    near = near_blur(frame, field, threads)
    gain = near.kernels.gain
    rounded = np.empty(frame.shape, np.uint8)
    close = np.empty((math.ceil(MOST_NEAR * frame.size), 3), np.int32)
    count = round_all(near.total, near.left, GREY, NEAR_MARGIN * gain, rounded, close)
    if count > len(close):
        return _rounded(blur(frame, field, threads))
    close = close[:count]
    values = _plain_values(frame, near, close)
    rounded[tuple(close.T)] = _rounded(values)
    closer = np.abs(values - np.floor(values) - 0.5) < MARGIN * gain
    if closer.sum() > MOST:
        return _rounded(blur(frame, field, threads))
    exact = ExactValues(frame, field, near.kernels.kernel)
    for (y, x, channel), value in zip(close[closer].tolist(), values[closer].tolist(), strict=True):
        decided = _with_noise(exact, y, x, channel, value, gain)
        if decided is None:
            decided = exact.value(y, x, channel)
            if _from_middle(decided) < TIE * gain:
                return _rounded(blur(frame, field, threads))
        rounded[y, x, channel] = _rounded(decided)
    return rounded


def _plain_values(frame: Frame, near: NearBlur, places: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
    """Grey levels at some places (n, 3), without the noise."""
    height, width = frame.shape[:2]
    pitch, _ = grid_of(height, width)
    rows, columns = Axis.of(height, pitch).nodes_at_pixels, Axis.of(width, pitch).nodes_at_pixels
    reach_x, reach_y = near.kernels.reach
    values = np.empty(len(places))
    plain_sums(
        places, near.pixels, near.left - reach_x, near.top - reach_y, near.kernels.plain, *columns, *rows, values
    )
    return values + GREY


def _with_noise(exact: ExactValues, y: int, x: int, channel: int, value: float, gain: float) -> float | None:
    """A value with as much of the noise as decides how it is rounded; None if all of it does not."""
    left = 1.0
    for weight, noise in exact.noise(y, x, channel, GREY):
        value += weight * noise
        left -= weight
        if _from_middle(value) >= gain * (FINE + MARGIN * left):
            return value
    return None


def _from_middle(value: float) -> float:
    return abs(value - math.floor(value) - 0.5)


def _rounded(values: npt.ArrayLike) -> Frame:
    return np.clip(np.rint(values), 0.0, 255.0).astype(np.uint8)
