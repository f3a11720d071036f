"""Measure how well a flow explains a pair of frames, without ground truth: the photometric error.

At a pixel, it is |frame 1 - frame 2 at the pixel's target| in grey levels, the means of R, G and B. Frame 2 is
interpolated bilinearly at targets rounded to 1/256 px. Only pixels whose target lies inside frame 2 count. The pixels
are computed and summed in integers, so the sums are bit-identical on every machine.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..compiled import njit_late, types
from ..sample import Flow, Frame
from .error_maps import FLOW_TYPE, dense, flow_array

UNIT = 3 * 256 * 256
"""Number of units of a map in one grey level: the sum of three channels, times the weights of the interpolation."""
_FRAME_TYPE = types.Array(types.uint8, 3, "C", readonly=True)


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
    _compare(frame1, frame2, flow, step, errors, sums)
    n, total, still = sums.tolist()
    return Photometric(n, total / UNIT, still / 3, errors)


@njit_late(
    types.void(_FRAME_TYPE, _FRAME_TYPE, FLOW_TYPE, types.int64, types.int32[:, ::1], types.int64[::1]), cache=True
)
def _compare(frame1: Any, frame2: Any, flow: Any, step: Any, errors: Any, sums: Any) -> None:
    height, width = frame2.shape[0], frame2.shape[1]
    columns = np.empty((height, width + 1), np.int64)  # a pixel in the low 32 bits, the one below it in the high 32
    for y in range(height):
        for x in range(width):
            columns[y, x] = np.int64(frame2[y, x, 0]) + frame2[y, x, 1] + frame2[y, x, 2]
        columns[y, width] = columns[y, width - 1]
    for y in range(height):
        for x in range(width + 1):
            columns[y, x] |= columns[min(y + 1, height - 1), x] << 32
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
