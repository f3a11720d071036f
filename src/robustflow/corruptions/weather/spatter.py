"""Add spatter: water or mud on the lens.

The distance to the edge of a drop is computed in integer arithmetic: OpenCV's `distanceTransform` may use Intel IPP,
which changes the last bits of the floats, and after rounding the results can differ by a grey level. The weights are
those of OpenCV's 5 x 5 mask: 1, 1.4 and 2.1969.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.rng import Rng
from ...core.types import Frame
from ..corruption import Corruption
from ..kernels.fields import UNIT, normal_field
from ..kernels.filters import Plane, gaussian_plane

WATER = (175.0, 238.0, 238.0)
MUD = (63.0, 42.0, 20.0)


class SpatterLayer(NamedTuple):
    """A spatter layer: out = x * (1 - opacity * covers) + opacity * colour."""

    opacity: Plane  # opacity of the layer, float32 (H, W), at least 0
    colour: tuple[float, float, float]  # RGB colour of the drops, 0 to 255
    covers: bool  # whether the drops hide the background (mud) or merely add their colour (water)


class SpatterLevel(NamedTuple):
    mean: float  # mean of the noise that is thresholded into drops, on [0, 1]
    deviation: float  # standard deviation of the noise
    sigma: float  # standard deviation of the blur that turns noise into drops, in pixels
    threshold: float  # threshold below which the noise does not form drops
    strength: float  # opacity of water, or sigma of the blur for mud
    mud: bool  # whether the drops are mud instead of water


class Spatter(Corruption):
    """Adds drops of water (severities 1 to 3) or mud (4 and 5) on the lens, shared by both frames (paper, appendix).

    The severity parameters are (mean and standard deviation of the noise, sigma of its blur, threshold, opacity of
    water or sigma of the blur for mud, whether the drops are mud); the values are from the reference code, since
    the paper does not list any. Sizes are in pixels regardless of the image size, and the colours are the RGB values
    specified by the authors.
    """

    name = "spatter"
    level = SpatterLevel
    paper_severities = (
        (0.65, 0.3, 4.0, 0.69, 0.6, False),
        (0.65, 0.3, 3.0, 0.68, 0.6, False),
        (0.65, 0.3, 2.0, 0.68, 0.5, False),
        (0.65, 0.3, 1.0, 0.65, 1.5, True),
        (0.67, 0.4, 1.0, 0.65, 1.5, True),
    )

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> SpatterLayer:
        mean, deviation, sigma, threshold, strength, mud = self.parameter(severity)
        noise = gaussian_plane(normal_field(rng, *shape), sigma)
        limit = np.float32((threshold - mean) / (deviation * UNIT))
        if mud:
            opacity = gaussian_plane((noise > limit).astype(np.uint8), strength)
            opacity[opacity < np.float32(0.8)] = 0
            return SpatterLayer(opacity, MUD, covers=True)
        liquid = np.empty(shape, np.uint8)
        _quantise(noise, limit, np.float32(mean * 255), np.float32(deviation * UNIT * 255), liquid)
        return SpatterLayer(_water(liquid, strength), WATER, covers=False)

    def apply(self, frame: Frame, state: SpatterLayer, index: int) -> Frame:
        frame = contiguous(frame)
        rows = frame.reshape(len(frame), -1)
        out = np.empty_like(rows)
        colour = np.array(state.colour, np.float32)
        work = np.empty((2, rows.shape[1]), np.float32)
        _blend(rows, state.opacity, colour, np.float32(state.covers), *work, out)
        return out.reshape(frame.shape)


def _water(liquid: npt.NDArray[np.uint8], strength: float) -> Plane:
    """Compute the opacity of drops with bright rims, like the reference code, but in integers except for the last
    step.
    """
    near = mean_distance(chamfer_distance(cv2.Canny(liquid, 50, 150), limit=20))
    emboss = np.array([[-2, -1, 0], [-1, 1, 1], [0, 1, 2]])
    relief = cv2.blur(cv2.filter2D(cv2.equalizeHist(near), cv2.CV_8U, emboss), (3, 3))
    opacity = liquid * relief.astype(np.float32)
    # without drops, which can happen in small images, the reference code divides zero by zero
    return opacity * np.float32(strength / max(float(opacity.max()), 1.0))


@njit(cache=True, nogil=True)
def _quantise(noise: Any, limit: Any, mean: Any, scale: Any, out: Any) -> None:
    """Set noise (H, W) below the limit to 0, and round the rest down to bytes."""
    for y in range(noise.shape[0]):
        row, target = noise[y], out[y]
        for x in range(row.size):
            value = min(mean + scale * row[x], np.float32(255))
            target[x] = np.uint8(value) if row[x] >= limit else np.uint8(0)


@njit(cache=True, nogil=True)
def _blend(rows: Any, opacity: Any, colour: Any, covers: Any, keep: Any, add: Any, out: Any) -> None:
    """Add the layer; it is first copied to all three channels, so that the last loop processes contiguous rows."""
    height, width = opacity.shape
    red, green, blue = colour[0], colour[1], colour[2]
    for y in range(height):
        source, layer, target = rows[y], opacity[y], out[y]
        for x in range(width):
            keep[3 * x] = keep[3 * x + 1] = keep[3 * x + 2] = np.float32(1) - covers * layer[x]
            add[3 * x], add[3 * x + 1], add[3 * x + 2] = layer[x] * red, layer[x] * green, layer[x] * blue
        for i in range(3 * width):
            value = keep[i] * np.float32(source[i]) + add[i]
            target[i] = np.uint8(np.rint(min(value, np.float32(255))))


_STRAIGHT, _DIAGONAL, _KNIGHT = 10_000, 14_000, 21_969


def chamfer_distance(edges: npt.NDArray[np.uint8], limit: int) -> npt.NDArray[np.int32]:
    """Compute the chamfer distance to the nearest nonzero pixel, int32 (H, W) in 1/10000 px, at most `limit` px."""
    far = limit * _STRAIGHT
    distance = np.where(edges > 0, 0, far).astype(np.int32)
    for _ in range(2):  # first from the upper left, then from the lower right
        _sweep(distance, far, np.full((2, distance.shape[1] + 4), far, np.int32), np.empty(distance.shape[1], np.int32))
        distance = np.ascontiguousarray(distance[::-1, ::-1])  # contiguous, so the loops are compiled only once
    return distance


def mean_distance(distance: npt.NDArray[np.int32]) -> npt.NDArray[np.uint8]:
    """Compute the mean distance in each 3 x 3 neighbourhood in pixels, rounded down: uint8 (H, W). Borders are
    mirrored.
    """
    sums = cv2.boxFilter(distance, cv2.CV_32S, (3, 3), normalize=False, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(sums // (9 * _STRAIGHT), np.uint8)


@njit(cache=True, nogil=True)
def _sweep(distance: Any, far: int, above: Any, line: Any) -> None:
    """Propagate shortest paths from the left and from the rows above; a work array contains the latest two of them,
    with a margin of two pixels.
    """
    height, width = distance.shape
    for y in range(height):
        one, two = above[(y + 1) % 2], above[y % 2]
        for x in range(width):
            straight = np.int32(one[x + 2] + _STRAIGHT)
            diagonal = np.int32(np.minimum(one[x + 1], one[x + 3]) + _DIAGONAL)
            knights = np.minimum(np.minimum(one[x], one[x + 4]), np.minimum(two[x + 1], two[x + 3]))
            line[x] = np.minimum(np.minimum(straight, diagonal), np.int32(knights + _KNIGHT))
        row = distance[y]
        left = np.int32(far)
        for x in range(width):
            left = np.minimum(np.minimum(row[x], line[x]), np.int32(left + _STRAIGHT))
            row[x] = left
            two[x + 2] = left
