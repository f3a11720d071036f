"""Add snow: each frame has different flakes, which fall in the same direction."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.rng import Rng
from ...core.types import Frame
from ..corruption import Corruption
from ..kernels.fields import UNIT, normal_field
from ..kernels.line_motion import LineKernel, line_kernel, move_plane


class SnowState(NamedTuple):
    flakes: Rng  # parent of the random streams for the flakes in each frame
    motion: LineKernel  # motion kernel of the flakes
    severity: int


class SnowLevel(NamedTuple):
    mean: float  # mean of the noise that is thresholded into flakes, on [0, 1]
    deviation: float  # standard deviation of the noise
    zoom: float  # zoom factor of the noise, which sets the flake size
    threshold: float  # threshold below which the noise does not form flakes
    radius: int  # radius of the motion blur, in pixels
    sigma: float  # standard deviation of the motion blur, in pixels
    share: float  # weight of the original image under the veil


class Snow(Corruption):
    """Whitens the frames and adds motion-blurred flakes (paper, appendix, weather; temporal).

    The severity parameters are (mean, standard deviation, zoom, threshold, motion radius, motion sigma, share of the
    image kept); the values are from the reference code, since the paper does not list any. Noise is enlarged,
    thresholded and blurred at an angle that is uniformly distributed between -135 and -45 degrees. The resulting layer
    and a copy rotated by 180 degrees are added to share * x + (1 - share) * max(x, 1.5 * grey + 0.5). The angle is
    shared by all frames; the flakes are different in each frame.
    """

    name = "snow"
    temporal = True
    level = SnowLevel
    paper_severities = (
        (0.1, 0.3, 3.0, 0.5, 10, 4, 0.8),
        (0.2, 0.3, 2.0, 0.5, 12, 4, 0.7),
        (0.55, 0.3, 4.0, 0.9, 12, 8, 0.7),
        (0.55, 0.3, 4.5, 0.85, 12, 8, 0.65),
        (0.55, 0.3, 2.5, 0.85, 12, 12, 0.55),
    )

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> SnowState:
        level: SnowLevel = self.parameter(severity)
        return SnowState(
            rng.spawn("flakes"), line_kernel(level.radius, level.sigma, rng.uniform(-135.0, -45.0)), severity
        )

    def apply(self, frame: Frame, state: SnowState, index: int) -> Frame:
        level: SnowLevel = self.parameter(state.severity)
        height, width = frame.shape[:2]
        rows, columns = -int(-height // level.zoom), -int(-width // level.zoom)
        field = normal_field(state.flakes.spawn("frame", index), rows, columns)
        flakes = np.empty((round(rows * level.zoom), round(columns * level.zoom)), np.uint16)
        places = _linear_positions(len(flakes), rows), _linear_positions(flakes.shape[1], columns)
        work = np.zeros((2, columns), np.float32)
        levels = (level.mean, level.deviation * UNIT, max(level.threshold, 0.0))
        _enlarge(field, *(np.float32(value * 65280) for value in levels), *places, *work, flakes)
        layer = move_plane(flakes, state.motion)
        out = np.empty((height, 3 * width), np.uint8)
        veils = np.empty((2, 3 * width), np.float32)
        _whiten(contiguous(frame).reshape(out.shape), layer, np.float32(level.share), *veils, out)
        return out.reshape(frame.shape)


def _linear_positions(long: int, short: int) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.float32]]:
    """Locate `long` points among `short` points that span the same range: (left index, weight of the right
    neighbour).
    """
    at = np.arange(long) * ((short - 1) / max(long - 1, 1))
    left = np.minimum(at.astype(np.int64), max(short - 2, 0))
    return left.astype(np.uint32), (at - left).astype(np.float32)


@njit(cache=True, nogil=True)
def _enlarge(
    field: Any, offset: Any, scale: Any, floor: Any, rows: Any, columns: Any, row: Any, slope: Any, out: Any
) -> None:
    """Zoom `offset + scale * field` bilinearly, set values below `floor` to zero, and clip to 65280."""
    (top, down), (left, along) = rows, columns
    last = field.shape[0] - 1, field.shape[1] - 1
    full = np.float32(65280)
    for y in range(out.shape[0]):
        a, b, t = field[top[y]], field[np.minimum(top[y] + 1, last[0])], down[y]
        for j in range(row.size):
            low, high = np.float32(a[j]), np.float32(b[j])
            row[j] = offset + scale * (low + t * (high - low))
        for j in range(last[1]):
            slope[j] = row[j + 1] - row[j]
        target = out[y]
        for x in range(target.size):
            value = row[left[x]] + along[x] * slope[left[x]]
            target[x] = np.uint16(min(value, full)) if value >= floor else np.uint16(0)


@njit(cache=True, nogil=True)
def _whiten(rows: Any, layer: Any, share: Any, veil: Any, snow: Any, out: Any) -> None:
    """Whiten rows (H, 3 W) towards grey, and add the layer (H, W) and the same turned by 180 degrees."""
    height, width = rows.shape[0], rows.shape[1] // 3
    rest, top = np.float32(1) - share, np.float32(255)
    for y in range(height):
        source, target = rows[y], out[y]
        flakes, turned = layer[y], layer[height - 1 - y, :width][::-1]
        for x in range(width):
            r, g, b = np.float32(source[3 * x]), np.float32(source[3 * x + 1]), np.float32(source[3 * x + 2])
            grey = np.float32(0.299) * r + np.float32(0.587) * g + np.float32(0.114) * b
            veil[3 * x] = veil[3 * x + 1] = veil[3 * x + 2] = np.float32(1.5) * grey + np.float32(127.5)
        for x in range(width):
            both = np.float32(np.int32(flakes[x]) + np.int32(turned[x]))
            snow[3 * x] = snow[3 * x + 1] = snow[3 * x + 2] = both
        for i in range(3 * width):
            value = np.float32(source[i])
            value = share * value + rest * max(value, veil[i]) + snow[i]
            target[i] = np.uint8(np.rint(min(value, top)))
