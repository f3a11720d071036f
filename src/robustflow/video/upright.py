"""Turn decoded pictures as players do: phones store a rotation beside the frames (a display matrix)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..sample import Frame


def upright(picture: Any, path: Path) -> Frame:
    """RGB uint8 (H, W, 3) of a decoded picture, turned as its display matrix asks.

    Raises:
        DataError: a rotation by other than multiples of 90 degrees.
    """
    quarter, rest = divmod(int(picture.rotation), 90)
    if rest:
        raise DataError(f"{path}: rotated by {picture.rotation} degrees; only quarter turns can be followed")
    return np.ascontiguousarray(np.rot90(picture.to_ndarray(format="rgb24"), quarter % 4))
