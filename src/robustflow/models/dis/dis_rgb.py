"""Dense inverse search on RGB frames, the version of DIS that was evaluated in the benchmark's paper."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...core.compiled import njit
from ...core.errors import unknown_name
from ...core.types import Flow, Frame
from ..pair_network import check_pair
from .pyramid import Image, enlarged, pyramid
from .refine import refined
from .search import Displacements, grid, in_search_area, inverse_search, search_area

_REACHED_BY_THE_PAPER = 5
"""The coarsest scale for frames 1024 px wide, at every operating point."""


@dataclass(frozen=True)
class OperatingPoint:
    """The parameters of an operating point; Kroeger et al. 2016, section 3."""

    finest_scale: int
    patch_size: int
    overlap: float
    iterations: int
    refined: bool

    @property
    def stride(self) -> int:
        """The distance between neighbouring patches in pixels."""
        return max(1, self.patch_size - int(self.patch_size * self.overlap))

    def scales(self, height: int, width: int) -> tuple[int, int]:
        """Return the coarsest and the finest scale for a frame size."""
        reach, room = 2 * max(height, width) // (5 * self.patch_size), min(height, width) // self.patch_size
        reached, roomy = (max(0, pixels.bit_length() - 1) for pixels in (reach, room))
        finest = max(0, self.finest_scale - max(0, _REACHED_BY_THE_PAPER - reached))
        return min(reached, roomy), min(finest, roomy)


OPERATING_POINTS = {
    1: OperatingPoint(finest_scale=3, patch_size=8, overlap=0.30, iterations=16, refined=False),
    2: OperatingPoint(finest_scale=3, patch_size=8, overlap=0.40, iterations=12, refined=True),
    3: OperatingPoint(finest_scale=1, patch_size=12, overlap=0.75, iterations=16, refined=True),
    4: OperatingPoint(finest_scale=0, patch_size=12, overlap=0.75, iterations=256, refined=True),
}


class DisRgb:
    """DIS on colour frames (Kroeger et al., "Fast Optical Flow using Dense Inverse Search", ECCV 2016).

    >>> frame = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    >>> flow = DisRgb().predict(frame, frame)
    >>> flow.shape, flow.dtype, bool(abs(flow).max() < 1e-4)
    ((48, 64, 2), dtype('float32'), True)
    """

    single_threaded = True

    def __init__(self, operating_point: int = 2) -> None:
        if operating_point not in OPERATING_POINTS:
            raise unknown_name("operating point of DIS", str(operating_point), map(str, OPERATING_POINTS))
        self._number = int(operating_point)

    def identity(self) -> dict[str, Any]:
        """Return the identity: the operating point and its parameters."""
        point = asdict(OPERATING_POINTS[self._number])
        return {"name": "dis_rgb", "operating_point": self._number, **point, "interpolation": "cubic spline"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`, for motion up to a fifth of the longer side."""
        check_pair(frame1, frame2)
        return dis_flow(frame1, frame2, OPERATING_POINTS[self._number])


def dis_flow(frame1: Frame, frame2: Frame, point: OperatingPoint) -> Flow:
    """Compute the flow from frame 1 to frame 2, float32 (H, W, 2)."""
    height, width = frame1.shape[:2]
    coarsest, finest = point.scales(height, width)
    # Every scale is exactly half the size of the previous one, and a patch fits into the coarsest scale.
    full_height, full_width = (max(-(-side >> coarsest) << coarsest, point.patch_size) for side in (height, width))
    images1 = pyramid(frame1, full_height, full_width, coarsest)
    images2 = pyramid(frame2, full_height, full_width, coarsest)
    flow: Flow = np.zeros((1, 1, 2), np.float32)
    for scale in range(coarsest, finest - 1, -1):
        image1, image2 = images1[scale], images2[scale]
        displacements = inverse_search(image1, image2, flow, point.patch_size, point.stride, point.iterations)
        flow = densified(image1, image2, displacements, point.patch_size, point.stride)
        if point.refined:
            flow = refined(image1, image2, flow, iterations=scale + 1)
    return enlarged(flow, 1 << finest, height, width)


def densified(image1: Image, image2: Image, displacements: Displacements, patch: int, stride: int) -> Flow:
    """Compute each pixel's flow as the weighted mean of the displacements u_i of the patches that cover it."""
    height, width = image1.shape[0], image1.shape[1] // 3
    total = np.zeros((height, width, 2), np.float32)
    rows, columns = grid(height, patch, stride), grid(width, patch, stride)
    _spread(image1, search_area(image2, patch), rows, columns, displacements, patch, total)
    return total


@njit(cache=True, nogil=True)
def _spread(image1: Any, image2: Any, rows: Any, columns: Any, displacements: Any, patch: int, total: Any) -> None:
    height, width, _ = total.shape
    weights = np.zeros((height, width), np.float32)
    squares = np.empty(3 * patch, np.float32)
    one = np.float32(1)
    for i in range(rows.size):
        for j in range(columns.size):
            y, x = rows[i], columns[j]
            u, v = displacements[i, j, 0], displacements[i, j, 1]
            y0, at_y = in_search_area(y + float(v), height, patch)
            x0, at_x = in_search_area(x + float(u), width, patch)
            wy, wx = np.float32(at_y), np.float32(at_x)
            w00, w01, w10, w11 = (one - wy) * (one - wx), (one - wy) * wx, wy * (one - wx), wy * wx
            for r in range(patch):
                here = image1[y + r, 3 * x : 3 * (x + patch)]
                above, below = image2[y0 + r, 3 * x0 :], image2[y0 + r + 1, 3 * x0 :]
                for k in range(3 * patch):
                    there = (w00 * above[k] + w01 * above[k + 3]) + (w10 * below[k] + w11 * below[k + 3])
                    squares[k] = (there - here[k]) * (there - here[k])
                for k in range(patch):
                    square = squares[3 * k] + squares[3 * k + 1] + squares[3 * k + 2]
                    weight = one / np.sqrt(max(one, square))
                    weights[y + r, x + k] += weight
                    total[y + r, x + k, 0] += weight * u
                    total[y + r, x + k, 1] += weight * v
    for y in range(height):
        for x in range(width):
            total[y, x, 0] /= weights[y, x]
            total[y, x, 1] /= weights[y, x]
