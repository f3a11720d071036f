"""Camera motion between two frames, expressed as the motion of points in camera coordinates."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...sample import Camera

FRAME_INTERVAL = 0.1
"""Time between the two frames of a pair, in seconds (10 Hz, as in KITTI)."""


class Motion(NamedTuple):
    """Camera motion between two frames: a point X in metres becomes `rotation @ X + translation`."""

    rotation: npt.NDArray[np.float64]
    """Rotation matrix, float64 (3, 3)."""
    translation: npt.NDArray[np.float64]
    """Translation in metres, float64 (3,)."""


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
