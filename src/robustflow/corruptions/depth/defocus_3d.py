"""Depth-dependent defocus: a thin lens focused on the near or the far part of the scene."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.rng import Rng
from ...core.types import DepthMap, Frame, SceneDepth
from ..corruption import DepthCorruption
from ..kernels.layered_disk import blur_layers

_NEAR, _FAR = 0.1, 0.9
"""Quantiles of the depths in frame 1 that define "near" and "far"."""
_EVERY = 16
"""Stride in pixels for estimating the "near" and "far" depths."""
LARGEST = 2.0
"""Maximum disk radius, as a multiple of the radius for the severity."""
_FINEST, _STEPS = 1.0, 6
"""Minimum step in radius between layers, in pixels, and maximum number of steps up to the largest radius."""


class ThinLens(NamedTuple):
    """A thin lens that blurs a point at depth Z to a disk of radius `infinity * |Z - focus| / Z`."""

    focus: float  # focus distance in metres
    infinity: float  # disk radius at infinity, in pixels
    largest: float  # largest disk radius, in pixels


class DefocusState(NamedTuple):
    lens: ThinLens
    depth: tuple[DepthMap, DepthMap]  # depth maps of both frames, in metres


class Defocus3d(DepthCorruption):
    """Blurs each pixel of both frames according to its depth, as a thin lens would.

    Pixels are grouped into layers of nearly equal blur, with radii in steps of one pixel or, if larger, a sixth of the
    maximum radius. Each layer is blurred with a uniform disk and composited over the layers behind it; see
    layered_disk.py. Both frames use the same lens. If the near and far depths are equal, nothing is blurred.
    """

    @abstractmethod
    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Return the lens that blurs the out-of-focus depth (`near` or `far`) by `radius` pixels."""

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> DefocusState:
        values = depth.maps[0].reshape(-1)[::_EVERY]
        places = [int(share * (values.size - 1)) for share in (_NEAR, _FAR)]
        near, far = np.partition(values, places)[places].tolist()
        return DefocusState(self.lens(float(self.parameter(severity)), near, far), depth.maps)

    def apply(self, frame: Frame, state: DefocusState, index: int) -> Frame:
        return blur_layers(frame, *_layers(np.ascontiguousarray(state.depth[index]), state.lens))


def _layers(depth: DepthMap, lens: ThinLens) -> tuple[npt.NDArray[np.uint8], list[float]]:
    """Return the layer index of each pixel and the radius of each layer, from the nearest to the farthest layer."""
    signed = np.empty(depth.shape, np.float32)
    low, high = _signed_radii(depth, *map(np.float32, lens), signed)
    spacing = max(_FINEST, max(abs(low), abs(high)) / _STEPS)
    count = int(-(-(high - low) // spacing))
    step = (high - low) / max(count, 1)
    layers = np.zeros(depth.shape, np.uint8)
    if count:
        _sort(signed, np.float32(low), np.float32(1 / step), np.uint8(count), layers)
    return layers, [abs(low + k * step) for k in range(count)] + [abs(high)]


@njit(cache=True, nogil=True)
def _signed_radii(depth: Any, focus: Any, infinity: Any, largest: Any, out: Any) -> Any:
    """Write signed radii (negative in front of the focus distance) to `out`; return the minimum and the maximum."""
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
    """Round signed blur radii (H, W) to the numbers of their layers, uint8 (H, W)."""
    for y in range(signed.shape[0]):
        source, target = signed[y], out[y]
        for x in range(source.size):
            target[x] = min(np.uint8(np.rint((source[x] - low) * scale)), last)


class NearFocus(Defocus3d):
    """Focuses both frames on the near part of the scene, which blurs the background."""

    name = "near_focus"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        return ThinLens(near, radius * far / (far - near) if far > near else 0.0, LARGEST * radius)


class FarFocus(Defocus3d):
    """Focuses both frames on the far part of the scene, so the blurred foreground spreads beyond its outlines."""

    name = "far_focus"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        return ThinLens(far, radius * near / (far - near) if far > near else 0.0, LARGEST * radius)
