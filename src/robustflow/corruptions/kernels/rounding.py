"""Round floating-point grey levels to bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def to_bytes(levels: npt.NDArray[np.floating[Any]], floor: bool = False) -> npt.NDArray[np.uint8]:
    """Clip to the range 0 to 255 and round half to even; with `floor`, truncate as some parts of the reference code
    do.
    """
    clipped = np.clip(levels, 0.0, 255.0)
    return (np.floor(clipped) if floor else np.rint(clipped)).astype(np.uint8)
