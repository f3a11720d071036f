"""Defocus in three dimensions: a thin lens that is focused on the near or on the far part of the scene."""

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
"""Shares of frame 1's pixels that are nearer than the "near" and the "far" depth."""
_EVERY = 16
"""Stride in pixels for finding these depths."""
LARGEST = 2.0
"""No disk is larger than this many times the one at the stated depth."""
_FINEST, _STEPS = 1.0, 6
"""Layers differ in radius by a pixel, or by this part of the largest radius, if that is more."""


class ThinLens(NamedTuple):
    """A thin lens: a point at depth Z has a disk of radius `infinity * |Z - focus| / Z`.

    That is (f^2 / N) |Z - F| / (Z (F - f)) / pitch / 2 with `infinity` for the factors that do not depend on Z.
    """

    focus: float
    """Metres."""
    infinity: float
    """Radius at infinity, pixels."""
    largest: float
    """Largest radius, pixels."""


class DefocusState(NamedTuple):
    """The lens, and the scene before it."""

    lens: ThinLens
    depth: tuple[DepthMap, DepthMap]
    """Of both frames, metres."""


class Defocus3d(DepthCorruption):
    """Both frames through a thin lens, out of focus by the depth of every pixel.

    Pixels are sorted into layers of nearly equal blur, a pixel apart in radius or a sixth of the largest radius, and
    each layer is blurred with a flat disk, the nearest over those behind it; see layered_disk.py. The lens is the same
    for both frames. A scene whose near and far part are at one depth is in focus.
    """

    @abstractmethod
    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """The lens that blurs the part out of focus by `radius` pixels."""

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> DefocusState:
        """The lens; nothing is random."""
        ordered = np.sort(depth.maps[0].reshape(-1)[::_EVERY])
        near, far = (float(ordered[int(share * (ordered.size - 1))]) for share in (_NEAR, _FAR))
        return DefocusState(self.lens(float(self.parameter(severity)), near, far), depth.maps)

    def apply(self, frame: Frame, state: DefocusState, index: int) -> Frame:
        """Blur frame `index`, 0 or 1."""
        return blur_layers(frame, *_layers(np.ascontiguousarray(state.depth[index]), state.lens))


def _layers(depth: DepthMap, lens: ThinLens) -> tuple[npt.NDArray[np.uint8], list[float]]:
    """(each pixel's layer, the radius of each layer).

    The first layer's radius is that of the nearest pixels, the last one's that of the farthest.
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
    """Radii, negative in front of the focus; (the smallest, the largest)."""
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
