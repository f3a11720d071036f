"""What depth corruptions share: the camera's motion between two frames, and light through a scattering medium."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import contiguous, njit
from ...core.types import Camera, DepthMap, Frame

FRAME_INTERVAL = 0.1
"""Time between the two frames of a pair, in seconds (10 Hz, as in KITTI)."""


class Motion(NamedTuple):
    """Camera motion between two frames: a point X in metres becomes `rotation @ X + translation`."""

    rotation: npt.NDArray[np.float64]  # rotation matrix, float64 (3, 3)
    translation: npt.NDArray[np.float64]  # translation in metres, float64 (3,)


def motion_of(camera: Camera) -> Motion | None:
    """Return the camera motion, or None if it is unknown.

    >>> motion_of(Camera((700.0, 700.0), (320.0, 240.0))) is None
    True
    """
    if camera.rotation is None or camera.translation is None:
        return None
    rotation, translation = np.array(camera.rotation, np.float64), np.array(camera.translation, np.float64)
    return Motion(np.ascontiguousarray(rotation), np.ascontiguousarray(translation))


STILL = Motion(np.eye(3), np.zeros(3))


@njit(cache=True, nogil=True, inline="always")
def moved(rotation: Any, translation: Any, x: Any, y: Any, z: Any) -> Any:
    """Return `rotation @ (x, y, z) + translation`, summed in a fixed order."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2],
    )


Transmission = npt.NDArray[np.float32]
"""Fraction of an object's light that reaches the camera, float32 (H, W) in (0, 1]."""

Lens = tuple[float, float, float, float] | npt.NDArray[np.float64]
"""Intrinsics fx, fy, cx, cy, in pixels."""

_STEPS, _THICKEST = 256, 16
"""Table entries per unit of optical thickness, and the thickness beyond which nothing is visible."""


def transmission(depth: DepthMap, lens: Lens, density: float, start: float = 0.0) -> Transmission:
    """Return exp(-density * d), accurate to 1e-5, where d is the length of a pixel's ray in the medium.

    >>> lens = (4.0, 4.0, 0.0, 0.0)  # the ray of the fourth pixel to the right is 5/4 as long as its depth
    >>> transmission(np.full((1, 4), 3.0, np.float32), lens, 0.5, 1.0)[0, ::3].round(4).tolist()
    [0.367..., 0.286...]
    """
    (height, width), (fx, fy, cx, cy) = depth.shape, lens
    down, across = ((np.arange(height) - cy) / fy) ** 2, ((np.arange(width) - cx) / fx) ** 2
    out = np.empty(depth.shape, np.float32)
    squares = down.astype(np.float32), across.astype(np.float32)
    _look_up(np.ascontiguousarray(depth), *squares, np.float32(density * _STEPS), np.float32(start), _decay(), out)
    return out


def veiled(frame: Frame, passed: Transmission, colour: npt.NDArray[np.float32]) -> Frame:
    """Return passed * frame + (1 - passed) * colour, rounded once.

    >>> frame, passed = np.full((1, 1, 3), 100, np.uint8), np.full((1, 1), 0.75, np.float32)
    >>> veiled(frame, passed, np.float32([200, 180, 100])).tolist()
    [[[125, 120, 100]]]
    """
    frame = contiguous(frame)
    out = np.empty_like(frame)
    _blend(frame, passed, colour, out)
    return out


@cache
def _decay() -> npt.NDArray[np.float32]:
    """Return a table of exp(-i / 256), computed from the Taylor series of exp(-i / 256 / 64) by squaring six times."""
    x = np.arange(_STEPS * _THICKEST + 2) / (-64.0 * _STEPS)
    total = term = np.ones_like(x)
    for order in range(1, 12):
        term = term * x / order
        total = total + term
    for _ in range(6):
        total = total * total
    return total.astype(np.float32)


@njit(cache=True, nogil=True)
def _look_up(depth: Any, down: Any, across: Any, scale: Any, start: Any, table: Any, out: Any) -> None:
    """Look up the length of each ray, depth (H, W) times sqrt(1 + `down` (H,) + `across` (W,)), in a table."""
    last = np.float32(table.shape[0] - 2)
    for y in range(depth.shape[0]):
        source, target, rest = depth[y], out[y], np.float32(1) + down[y]
        for x in range(source.shape[0]):
            place = min(max(source[x] - start, np.float32(0)) * (np.sqrt(rest + across[x]) * scale), last)
            below = np.int32(place)
            part = place - np.float32(below)
            target[x] = table[below] + part * (table[below + 1] - table[below])


@njit(cache=True, nogil=True)
def _blend(frame: Any, passed: Any, colour: Any, out: Any) -> None:
    """Mix a frame (H, W, 3) with one colour: `passed` (H, W) is the frame's share of each pixel."""
    red, green, blue = colour[0], colour[1], colour[2]
    for y in range(frame.shape[0]):
        source, target, row = frame[y], out[y], passed[y]
        for x in range(row.size):
            share = row[x]
            rest = np.float32(1) - share
            target[x, 0] = np.uint8(np.rint(share * np.float32(source[x, 0]) + rest * red))
            target[x, 1] = np.uint8(np.rint(share * np.float32(source[x, 1]) + rest * green))
            target[x, 2] = np.uint8(np.rint(share * np.float32(source[x, 2]) + rest * blue))
