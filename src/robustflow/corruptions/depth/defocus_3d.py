"""Apply depth-dependent defocus with a thin lens focused on the near or the far part of the scene."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...random.rng import Rng
from ...sample import DepthMap, Frame, SceneDepth
from ..base import DepthCorruption
from ..kernels.layered_disk import blur_layers

_NEAR, _FAR = 0.1, 0.9
"""Fractions of frame 1's pixels that are closer than the "near" and the "far" depth."""
_EVERY = 16
"""Stride in pixels for estimating the "near" and "far" depths."""
LARGEST = 2.0
"""Largest disk radius as a multiple of the severity's radius."""
_FINEST, _STEPS = 1.0, 6
"""Smallest radius step between layers in pixels, and largest number of steps up to the largest radius."""


class ThinLens(NamedTuple):
    """A thin lens: a point at depth Z has a disk of radius `infinity * |Z - focus| / Z`.

    This is (f^2 / N) |Z - F| / (Z (F - f)) / pitch / 2, where `infinity` combines the factors that do not depend on Z.
    """

    focus: float
    """Focus distance in metres."""
    infinity: float
    """Disk radius at infinity, in pixels."""
    largest: float
    """Largest disk radius, in pixels."""


class DefocusState(NamedTuple):
    """State of a pair: the lens and the depth of the scene."""

    lens: ThinLens
    depth: tuple[DepthMap, DepthMap]
    """Depth maps of both frames, in metres."""


class Defocus3d(DepthCorruption):
    """Blurs both frames like a thin lens, depending on the depth of every pixel.

    Pixels are grouped into layers of nearly equal blur, whose radii differ by one pixel or a sixth of the largest
    radius. Each layer is blurred with a flat disk and composited over the layers behind it; see layered_disk.py. The
    lens is the same for both frames. A scene whose near and far depths are equal is in focus.
    """

    @abstractmethod
    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Return the lens that blurs the part that is out of focus by `radius` pixels."""

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> DefocusState:
        """Compute the lens; nothing is random."""
        ordered = np.sort(depth.maps[0].reshape(-1)[::_EVERY])
        near, far = (float(ordered[int(share * (ordered.size - 1))]) for share in (_NEAR, _FAR))
        return DefocusState(self.lens(float(self.parameter(severity)), near, far), depth.maps)

    def apply(self, frame: Frame, state: DefocusState, index: int) -> Frame:
        """Blur frame `index`, 0 or 1."""
        return blur_layers(frame, *_layers(np.ascontiguousarray(state.depth[index]), state.lens))


def _layers(depth: DepthMap, lens: ThinLens) -> tuple[npt.NDArray[np.uint8], list[float]]:
    """Return (layer index of each pixel, radius of each layer).

    The first layer has the radius of the nearest pixels, the last layer that of the farthest pixels.
    """
    signed = np.empty(depth.shape, np.float32)
    low, high = _signed_radii(depth, *map(np.float32, lens), signed)
    apart = max(_FINEST, max(abs(low), abs(high)) / _STEPS)
    count = int(-(-(high - low) // apart))
    step = (high - low) / max(count, 1)
    layers = np.zeros(depth.shape, np.uint8)
    if count:
        _sort(signed, np.float32(low), np.float32(1 / step), np.uint8(count), layers)
    return layers, [abs(low + k * step) for k in range(count)] + [abs(high)]


@njit(cache=True, nogil=True)
def _signed_radii(depth: Any, focus: Any, infinity: Any, largest: Any, out: Any) -> Any:
    """Compute the radii, negative in front of the focus; return (smallest, largest)."""
    low, high = largest, -largest
    for y in range(depth.shape[0]):
        source, target = depth[y], out[y]
        for x in range(source.size):
            value = infinity * (source[x] - focus) / source[x]
            target[x] = min(max(value, -largest), largest)
            low, high = min(low, target[x]), max(high, target[x])
    return float(low), float(high)


@njit(cache=True, nogil=True)
def _sort(signed: Any, low: Any, scale: Any, last: Any, out: Any) -> None:
    for y in range(signed.shape[0]):
        source, target = signed[y], out[y]
        for x in range(source.size):
            target[x] = min(np.uint8(np.rint((source[x] - low) * scale)), last)
