"""Rotate decoded frames as video players do; phones store a display matrix instead of rotating the frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..sample import Frame


def upright(picture: Any, path: Path) -> Frame:
    """Convert a decoded frame to RGB uint8 (H, W, 3), rotated according to its display matrix.

    Raises:
        DataError: the rotation is not a multiple of 90 degrees.
    """
    quarter, rest = divmod(int(picture.rotation), 90)
    if rest:
        raise DataError(f"{path}: rotated by {picture.rotation} degrees; only multiples of 90 degrees are supported")
    return np.ascontiguousarray(np.rot90(picture.to_ndarray(format="rgb24"), quarter % 4))
